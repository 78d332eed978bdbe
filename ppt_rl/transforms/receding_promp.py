"""A short movement primitive along the heading that begins anew at every policy step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor

from ppt_rl.functional.argument_checks import require_in_range, require_instance, require_numbers
from ppt_rl.functional.heading import from_heading, to_heading
from ppt_rl.modules.promp import ProMP
from ppt_rl.modules.task_space import TaskSpace
from ppt_rl.transforms.promp import ProMPTransform

__all__ = ["RecedingKeys", "RecedingProMPTransform"]


@dataclass(frozen=True)
class RecedingKeys:
    """Entries of a :class:`RecedingProMPTransform`.

    Attributes:
        action: the action: residual outside, references towards the environment.
        pose: end-effector pose.
        heading: heading of the tool, as :class:`HeadingFrameTransform` writes it.
        weights: reference weights, as :class:`ViaPointTransform` writes them; where missing, the prior's mean.
        twist: measured twist; read only with a ``max_slip``, like the next two.
        contact: whether the tool touches a wall, as :class:`ContactViaPointTransform` writes it.
        tangent: unit vector along the wall, world axes on the map, as that transform writes it.
    """

    action: NestedKey = "action"
    pose: NestedKey = "pose"
    heading: NestedKey = "heading"
    weights: NestedKey = "weights_mean"
    twist: NestedKey = "twist"
    contact: NestedKey = "contact"
    tangent: NestedKey = "via_tangent"


class RecedingProMPTransform(ProMPTransform):
    r"""A :class:`ProMPTransform` whose primitive begins anew at every policy step, in the frame of the tool.

    Weights, via-points and residual are in heading axes (ahead, left, up). With the end effector's position ``x``, its
    heading ``psi`` and the last reference ``y_0``, all at the policy step,

    .. math::
        y(\phi) = o + R_z(\psi)\, \Phi(\phi)^\top W, \qquad
        o = x + R_z(\psi)\,\mathrm{clip}\big(R_z(-\psi)(y_0 - x),\ -l,\ l\big), \qquad
        w = w_{ref} + \mathrm{scale} \cdot \Delta w

    The first ``replan_steps`` of the primitive are executed, or fewer where the macro step is interrupted. Then the
    next one takes over, continuous in reference and velocity. The origin ``o`` is at most the lead ``l`` from the tool,
    so the reference cannot run away from a blocked tool: the primitive leads from the old reference to where it would
    be from that origin.

    With a slip ``s``, the starting velocity follows what the tool touches, because contact turns the tool within
    milliseconds. Let ``near(a, b) = a + clip(b - a, -s, s)``. Where the tool touches a wall (tangent ``t``, normal
    ``n``) the primitive starts on the map with the first velocity; vertically it always starts with the second, as
    there is always a floor:

    .. math:: \dot y_{0,xy}' = |\dot y_{0,xy}|\, t + \mathrm{near}(\dot x \cdot n,\ \dot y_0 \cdot n)\, n, \qquad
        \dot y_{0,z}' = \mathrm{near}(\dot x_z,\ \dot y_{0,z})

    That is: as fast as before along the wall, but across wall and floor at most ``s`` faster or slower than the tool,
    which is then not pressed on into the wall or a ramp. Away from walls the velocity on the map stays continuous.

    State and observations are those of :class:`ProMPTransform`; ``reference_position`` and ``reference_velocity`` are
    in world coordinates, ``weights`` in the tool's frame, and ``phase`` is where the last primitive ended.

    Args:
        promp: the movement primitive, of three coordinates.
        task_space: task space with the coordinates x, y, z.
        residual_scale: one number, or three: how far a residual of 1 moves a weight ahead, to the left and up [m].
        max_lead: l, three numbers: how far ahead, to the left and up of the tool a primitive may begin [m]. With zeros
            it begins at the tool.
        max_slip: s, how much faster or slower than the tool a primitive may begin across wall and floor [m/s]; None
            sets no limit.
        replan_steps: control steps from one policy step to the next.
        dt: control step [s]; None takes it from the environment, and needs one.
        keys: entries that are read and written; None takes the defaults.

    Raises:
        ValueError: if the task space has other coordinates than x, y, z, or as for :class:`ProMPTransform`.

    Source:
        Paper, eqs. (11) and (13); the frame and the receding horizon are ours.
    """

    def __init__(
        self,
        promp: ProMP,
        task_space: TaskSpace,
        *,
        residual_scale: float | Sequence[float] = 0.01,
        max_lead: Sequence[float] = (0.002, 0.001, 0.0),
        max_slip: float | None = None,
        replan_steps: int = 20,
        dt: float | None = None,
        keys: RecedingKeys | None = None,
    ) -> None:
        require_instance("promp", promp, ProMP)
        require_instance("task_space", task_space, TaskSpace)
        if task_space.axes != ("x", "y", "z"):
            raise ValueError(f"task_space has the coordinates {task_space.axes}; expected ('x', 'y', 'z').")
        keys = RecedingKeys() if keys is None else keys
        require_instance("keys", keys, RecedingKeys)
        super().__init__(
            promp, task_space, residual_scale=residual_scale, replan_steps=replan_steps, dt=dt, action_key=keys.action,
            pose_key=keys.pose, weights_key=keys.weights,
        )  # fmt: skip
        self.keys = keys
        self.max_slip = None if max_slip is None else require_in_range("max_slip", max_slip, 0.0, unit="m/s, or None")
        self.register_buffer("max_lead", require_numbers("max_lead", max_lead, (3,), low=0.0, unit="m"))

    @property
    def _readings(self) -> tuple[NestedKey, ...]:
        keys = self.keys
        touch = () if self.max_slip is None else (keys.twist, keys.contact, keys.tangent)
        return keys.pose, keys.heading, *touch

    def _current(self, tensordict: TensorDictBase, action: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        origin, heading = self._frame(tensordict)
        position, velocity = (self._known(tensordict, key) for key in ("reference_position", "reference_velocity"))
        if position is None or velocity is None:
            position, velocity = origin, torch.zeros_like(origin)
        phase = torch.zeros_like(action[..., :1])
        return phase, to_heading(position - origin, heading), to_heading(self._turned(tensordict, velocity), heading)

    def _turned(self, tensordict: TensorDictBase, velocity: Tensor) -> Tensor:
        """Velocity ``(*B, 3)`` at which the primitive begins, world axes: along what the tool touches."""
        if self.max_slip is None:
            return velocity
        twist, contact, tangent = self._recall(tensordict, self.keys.twist, self.keys.contact, self.keys.tangent)
        normal = torch.stack([-tangent[..., 1], tangent[..., 0]], -1)
        tool, wanted = (
            torch.cat([(v[..., :2] * normal).sum(-1, keepdim=True), v[..., 2:3]], -1) for v in (twist, velocity)
        )
        across, vertical = (tool + (wanted - tool).clamp(-self.max_slip, self.max_slip)).split(1, -1)
        along = torch.linalg.vector_norm(velocity[..., :2], dim=-1, keepdim=True)
        on_map = torch.where(contact, along * tangent + across * normal, velocity[..., :2])
        return torch.cat([on_map, vertical], -1)

    def _placed(self, tensordict: TensorDictBase, positions: Tensor, velocities: Tensor) -> tuple[Tensor, Tensor]:
        origin, heading = (value.unsqueeze(-2) for value in self._frame(tensordict))
        return origin + from_heading(positions, heading), from_heading(velocities, heading)

    def _frame(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
        """Origin ``(*B, 3)`` and heading ``(*B, 1)`` of the primitive's frame in world."""
        pose, heading = self._recall(tensordict, self.keys.pose, self.keys.heading)
        tool = self.task_space.project(pose)
        reference = self._known(tensordict, "reference_position")
        if reference is None:
            return tool, heading
        lead = self.max_lead.to(tool.dtype)
        ahead = to_heading(reference - tool, heading).clamp(-lead, lead)
        return tool + from_heading(ahead, heading), heading
