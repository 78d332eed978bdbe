"""A short movement primitive along the heading, planned anew from where the tool is."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor

from ppt_rl.functional.heading import from_heading, to_heading
from ppt_rl.modules.promp import ProMP
from ppt_rl.modules.task_space import TaskSpace
from ppt_rl.transforms.promp import ProMPTransform

__all__ = ["RecedingProMPTransform"]


class RecedingProMPTransform(ProMPTransform):
    r"""A :class:`ProMPTransform` whose primitive begins anew at every policy step, in the frame of the tool.

    .. math::
        y(\phi) = o + R_z(\psi)\, \Phi(\phi)^\top W, \qquad
        o = x + R_z(\psi)\,\mathrm{clip}\big(R_z(-\psi)(y_0 - x),\ -l,\ l\big), \qquad
        w = w_{ref} + \mathrm{scale} \cdot \Delta w

    with the end effector's position ``x``, its heading ``psi`` and the last reference ``y_0`` at the policy step:
    weights, via-points and residual are in heading axes (ahead, left, up). Of the primitive's duration the first
    ``replan_steps`` are executed, or fewer where the macro step is interrupted, then the next one takes over,
    continuous in reference and velocity. A blocked tool does not let the reference run away: the frame's
    origin is at most the lead ``l`` from the tool, and the primitive leads from the old reference to where it would be
    from there. What the tool touches has turned it within milliseconds, and the reference turns with it. With
    ``near(a, b) = a + clip(b - a, -s, s)`` and a slip ``s``, the primitive begins, on the map where a wall is touched
    (observation ``contact``, tangent ``t``, normal ``n``), and vertically everywhere, as there is always a floor, at

    .. math:: \dot y_{0,xy}' = |\dot y_{0,xy}|\, t + \mathrm{near}(\dot x \cdot n,\ \dot y_0 \cdot n)\, n, \qquad
        \dot y_{0,z}' = \mathrm{near}(\dot x_z,\ \dot y_{0,z})

    as fast as before along the wall, and across wall and floor at most the slip faster or slower than the tool, which
    is not pressed on the way it wanted to go, nor into a ramp. Away from walls ``xy`` is continuous in velocity too,
    and without ``s`` everything is.

    State and observations as for :class:`ProMPTransform`; ``reference_position`` and ``reference_velocity`` are in
    world coordinates, ``weights`` in the tool's frame, and ``phase`` is where the last primitive was left.

    Args:
        promp: the movement primitive, of three coordinates.
        task_space: with the coordinates x, y, z.
        residual_scale: one number, or three: how far a residual of 1 moves a weight ahead, to the left and up [m].
        max_lead: l, three numbers: how far ahead, to the left and up of the tool a primitive may begin [m]. Zero begins
            at the tool itself.
        max_slip: s, how much faster or slower than the tool a primitive may begin across wall and floor [m/s]; None for
            no limit.
        replan_steps: control steps from one policy step to the next.
        dt: control step [s]; None takes it from the environment, and needs one.
        action_key: the action: residual outside, references towards the environment.
        pose_key: end-effector pose observation.
        twist_key: measured twist; needed for ``max_slip`` only.
        contact_key: contact observation, as :class:`ContactViaPointTransform` writes it; likewise.
        tangent_key: of the wall, world axes on the map, as that transform writes it; likewise.
        heading_key: heading observation, as :class:`HeadingFrameTransform` writes it.
        weights_key: reference weights, as :class:`ViaPointTransform` writes them; where missing, the prior's mean.

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
        action_key: NestedKey = "action",
        pose_key: NestedKey = "pose",
        twist_key: NestedKey = "twist",
        contact_key: NestedKey = "contact",
        tangent_key: NestedKey = "via_tangent",
        heading_key: NestedKey = "heading",
        weights_key: NestedKey = "weights_mean",
    ) -> None:
        if task_space.axes != ("x", "y", "z"):
            raise ValueError(f"task_space has the coordinates {task_space.axes}; expected ('x', 'y', 'z').")
        super().__init__(
            promp, task_space, residual_scale=residual_scale, replan_steps=replan_steps, dt=dt, action_key=action_key,
            pose_key=pose_key, weights_key=weights_key,
        )  # fmt: skip
        self.heading_key, self._wall_keys = heading_key, (twist_key, contact_key, tangent_key)
        if max_slip is not None and not 0 <= max_slip < math.inf:
            raise ValueError(f"max_slip is {max_slip}; expected at least 0 m/s, or None.")
        self.max_slip = max_slip
        lead = torch.as_tensor(max_lead, dtype=torch.get_default_dtype())
        if lead.shape != (3,) or not bool((lead >= 0).all() & lead.isfinite().all()):
            raise ValueError(f"max_lead is {max_lead}; expected three numbers of at least 0 m.")
        self.register_buffer("max_lead", lead)

    def _current(self, tensordict: TensorDictBase, action: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        origin, heading = self._frame(tensordict)
        position, velocity = (tensordict.get(key, None) for key in ("reference_position", "reference_velocity"))
        if position is None or velocity is None:
            position, velocity = origin, torch.zeros_like(origin)
        phase = torch.zeros_like(action[..., :1])
        return phase, to_heading(position - origin, heading), to_heading(self._turned(tensordict, velocity), heading)

    def _turned(self, tensordict: TensorDictBase, velocity: Tensor) -> Tensor:
        """Velocity to begin at, world: along what the tool touches."""
        if self.max_slip is None:
            return velocity
        twist, contact, tangent = self._require(tensordict, *self._wall_keys)
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
        pose, heading = self._require(tensordict, self.pose_key, self.heading_key)
        tool = self.task_space.project(pose)
        reference = tensordict.get("reference_position", None)
        if reference is None:
            return tool, heading
        lead = self.max_lead.to(tool.dtype)
        ahead = to_heading(reference - tool, heading).clamp(-lead, lead)
        return tool + from_heading(ahead, heading), heading
