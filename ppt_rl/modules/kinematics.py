"""Forward kinematics, geometric Jacobian and inverse kinematics of an arm, on pytorch-kinematics."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ppt_rl.arms import Arm
from ppt_rl.functional.argument_checks import require_in_range, require_instance, require_whole
from ppt_rl.functional.checks import require_finite, require_last_dim, require_positive
from ppt_rl.functional.impedance import orientation_error
from ppt_rl.functional.rotations import matrix_to_quat
from ppt_rl.modules.serial_chain import offsets_of, serial_chain

__all__ = ["Kinematics"]


#: Longest tool [m].
_LONGEST = 2.0


def _inertials(arm: Arm) -> tuple[Tensor, Tensor, Tensor]:
    """Mass ``(n,)``, centre of mass ``(n, 3)`` and inertia ``(n, 3, 3)`` of the links, each in its joint's frame."""
    f64 = torch.float64
    xx, yy, zz, xy, xz, yz = torch.tensor([link.inertia for link in arm.links], dtype=f64).unbind(-1)
    inertia = torch.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], -1).unflatten(-1, (3, 3))
    mass = torch.tensor([link.mass for link in arm.links], dtype=f64)
    return mass, torch.tensor([link.com for link in arm.links], dtype=f64), inertia


class Kinematics(nn.Module):
    """Pose and Jacobian of an arm's end-effector point as differentiable functions of joint position.

    The base frame is the world frame. The end-effector point lies ``tool_length`` beyond the flange along its axis. In
    the shapes below, ``n`` is the number of joints.

    The constants of the arm are those of a serial chain of pytorch-kinematics, ``kinematics.chain``, whose other
    functions serve as well. Pose and Jacobian are written out for joints about z, at a fraction of the time of walking
    a general tree.

    Args:
        arm: the arm; an environment's is ``env.arm``.
        tool_length: distance from flange to end-effector point [m]; an environment's is ``env.tool_length``.
        dtype: precision of the kinematic constants, to which inputs are cast.

    Raises:
        ValueError: if the arm is none, the tool's length is out of range, or the precision is not a floating one.

    Examples:
        >>> from ppt_rl.arms import PANDA
        >>> kinematics = Kinematics(PANDA, tool_length=0.15)
        >>> pose, jacobian = kinematics(torch.zeros(2, 7))
        >>> pose.shape, jacobian.shape
        (torch.Size([2, 7]), torch.Size([2, 6, 7]))
    """

    _anchor: Tensor

    def __init__(self, arm: Arm, tool_length: float, dtype: torch.dtype = torch.float32) -> None:
        super().__init__()
        require_instance("arm", arm, Arm)
        if not isinstance(dtype, torch.dtype) or not dtype.is_floating_point:
            raise ValueError(f"dtype is {dtype}; expected torch.float32 or torch.float64.")
        self.arm = arm
        self.tool_length = require_in_range("tool_length", tool_length, 0.0, _LONGEST, "m")
        # `.to()` moves this buffer, and the constants, which are exact in float64, are then built anew to match it.
        self.register_buffer("_anchor", torch.zeros((), dtype=dtype), persistent=False)
        self.chain = serial_chain(arm, self.tool_length)
        self._build()

    def _build(self) -> None:
        """Build the constants in the precision and on the device of the anchor."""
        self._offsets = offsets_of(self.chain).to(self._anchor)
        self._inertials = tuple(value.to(self._anchor) for value in _inertials(self.arm))
        self._armature = torch.tensor(self.arm.joints.armature, dtype=torch.float64).to(self._anchor).diag()
        # A joint's pose in the frame before it is fixed + cos(q) even + sin(q) odd, (n, 1, 4, 4) each.
        x, y, z, origin = self._offsets[:-1].unsqueeze(1).unbind(-1)
        zero = torch.zeros_like(x)
        self._even, self._odd = torch.stack([x, y, zero, zero], -1), torch.stack([y, -x, zero, zero], -1)
        self._fixed = torch.stack([zero, zero, z, origin], -1)

    def _follow_anchor(self) -> None:
        """Build the constants anew where the module was moved or its precision changed."""
        anchor, offsets = self._anchor, self._offsets
        if offsets.dtype != anchor.dtype or offsets.device != anchor.device:
            self._build()

    def forward(self, joint_position: Tensor) -> tuple[Tensor, Tensor]:
        """Compute pose and Jacobian together.

        Args:
            joint_position: ``(*B, n)`` [rad].

        Returns:
            Pose ``(*B, 7)`` in world [m, -], and geometric Jacobian ``(*B, 6, n)`` in world axes, linear rows first.

        Raises:
            ValueError: if the last dimension is not n.
        """
        jacobian, matrix = self._jacobian_and_matrix(joint_position)
        pose = torch.cat([matrix[..., :3, 3], matrix_to_quat(matrix[..., :3, :3])], -1)
        return pose, jacobian

    def jacobian(self, joint_position: Tensor) -> Tensor:
        """Compute the geometric Jacobian J, with ``twist = J joint_velocity``.

        Args:
            joint_position: ``(*B, n)`` [rad].

        Returns:
            ``(*B, 6, n)`` in world axes, linear rows first, at the end-effector point.

        Raises:
            ValueError: if the last dimension is not n.
        """
        return self._jacobian_and_matrix(joint_position)[0]

    def inertia(self, joint_position: Tensor) -> Tensor:
        r"""Compute the joint-space inertia matrix of the arm without its tool.

        .. math:: M = \mathrm{diag}(a) + \sum_i \big(m_i J_{v,i}^\top J_{v,i} + J_{\omega,i}^\top I_i J_{\omega,i}\big)

        where ``J_{v,i}`` and ``J_{\omega,i}`` belong to the centre of mass of link i, and ``a`` is the armature.

        Args:
            joint_position: ``(*B, n)`` [rad].

        Returns:
            ``(*B, n, n)`` [kg m^2].

        Raises:
            ValueError: if the last dimension is not n.
        """
        count = self.arm.num_joints
        require_last_dim("joint_position", joint_position, count)
        self._follow_anchor()
        angle = joint_position.reshape(-1, count).to(self._anchor.dtype)
        links = self._frames(angle)[:-1].transpose(0, 1)  # (B, n, 4, 4)
        turn, origin, axis = links[..., :3, :3], links[..., :3, 3], links[..., :3, 2]
        mass, com, inertia = self._inertials
        centre = origin + (turn @ com.unsqueeze(-1)).squeeze(-1)
        moved = torch.ones(count, count, dtype=angle.dtype, device=angle.device).tril().unsqueeze(-1)  # link, joint
        angular = axis.unsqueeze(1) * moved  # (B, link, joint, 3)
        linear = torch.linalg.cross(angular, centre.unsqueeze(2) - origin.unsqueeze(1))
        world = turn @ inertia @ turn.mT
        total = mass[:, None, None] * linear @ linear.mT + angular @ world @ angular.mT
        matrix = total.sum(1) + self._armature
        return matrix.reshape(*joint_position.shape[:-1], count, count)

    def inverse(self, pose: Tensor, guess: Tensor, iterations: int = 60, damping: float = 0.1) -> Tensor:
        """Find a joint position that reaches ``pose``, by damped Gauss-Newton steps from ``guess``.

        Args:
            pose: ``(*B, 7)`` desired pose in world [m, -].
            guess: ``(*B, n)`` joint position to start from [rad]; the solution found is near it.
            iterations: largest number of steps.
            damping: damping of the least-squares steps [-].

        Returns:
            ``(*B, n)`` joint position within the arm's limits [rad].

        Raises:
            ValueError: if a pose is not reached within 0.1 mm and 0.1 mrad, or an argument does not fit.
        """
        require_last_dim("pose", pose, 7)
        require_last_dim("guess", guess, self.arm.num_joints)
        require_finite("pose", pose)
        require_finite("guess", guess)
        iterations, damping = require_whole("iterations", iterations), require_positive("damping", damping)
        position = guess.clone()
        low, high = position.new_tensor(self.arm.joints.position_limits).unbind(-1)
        for _ in range(iterations):
            reached, jacobian = self.forward(position)
            error = torch.cat(
                [pose[..., :3] - reached[..., :3], orientation_error(reached[..., 3:], pose[..., 3:])], -1
            )
            searching = (
                error.abs().amax(-1, keepdim=True) >= 1e-7
            )  # each row by itself: others do not change its result
            if not bool(searching.any()):
                break
            gram = jacobian @ jacobian.mT + damping**2 * torch.eye(6, dtype=jacobian.dtype, device=jacobian.device)
            step = (jacobian.mT @ torch.linalg.solve(gram, error.unsqueeze(-1))).squeeze(-1)
            position = torch.where(searching, torch.maximum(torch.minimum(position + step, high), low), position)
        # The orientation error also vanishes half a turn away, where the quaternions are orthogonal.
        turned_over = (reached[..., 3:] * pose[..., 3:]).sum(-1).abs() < 0.5
        missed = (error.abs().amax(-1) > 1e-4) | turned_over
        if bool(missed.any()):
            raise ValueError(
                f"no joint position found for {int(missed.sum())} of the poses (error up to "
                f"{float(error.abs().amax()):.3g}); expected poses that {self.arm.name} reaches near the guess."
            )
        return position

    def _jacobian_and_matrix(self, joint_position: Tensor) -> tuple[Tensor, Tensor]:
        count = self.arm.num_joints
        require_last_dim("joint_position", joint_position, count)
        self._follow_anchor()
        batch = joint_position.shape[:-1]
        frames = self._frames(joint_position.reshape(-1, count).to(self._offsets.dtype))
        tip, joints = frames[-1], frames[:-1, :, :3]  # (B, 4, 4) and (n, B, 3, 4)
        _, _, axis, origin = joints.unbind(-1)
        linear = torch.linalg.cross(axis, tip[:, :3, 3] - origin)
        jacobian = torch.cat([linear, axis], -1).permute(1, 2, 0).contiguous()  # (B, 6, n)
        return (jacobian, tip) if len(batch) == 1 else (jacobian.view(*batch, 6, count), tip.view(*batch, 4, 4))

    def _frames(self, joint_position: Tensor) -> Tensor:
        """``(n + 1, B, 4, 4)`` poses in world of the links and the tool, in this order.

        The product along the chain is written out for joints about z.
        """
        angle = joint_position.t().view(self.arm.num_joints, -1, 1, 1)
        joints = torch.addcmul(self._fixed, angle.cos(), self._even).add_(angle.sin() * self._odd)
        first, *others = joints.unbind(0)
        frames = [first]
        for offset in (*others, self._offsets[-1].expand_as(first)):
            frames.append(torch.bmm(frames[-1], offset))
        return torch.stack(frames)
