"""Step-wise control: a bounded Cartesian velocity becomes the reference of the impedance controller."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Bounded, Composite, TensorSpec

from ppt_rl.functional.argument_checks import require_instance
from ppt_rl.functional.checks import require_finite, require_last_dim
from ppt_rl.functional.heading import from_heading
from ppt_rl.modules.joint_space import JointSpace
from ppt_rl.modules.task_space import TaskSpace
from ppt_rl.transforms.base import ActionTransform
from ppt_rl.transforms.specs import real, replace_leaf
from ppt_rl.transforms.timed import TimedTransform

__all__ = ["CartesianVelocityTransform"]


class CartesianVelocityTransform(TimedTransform, ActionTransform):
    r"""Integrates a velocity ``a`` ``(*B, D)`` in [-1, 1] to a reference ``(*B, 13)`` of pose and twist.

    .. math::
        y' = y_m + \mathrm{clip}\big(y + v_{max}\,\mathrm{clip}(a, -1, 1)\,\Delta t - y_m,\ -l,\ l\big),
        \qquad v = (y' - y) / \Delta t

    for each coordinate (yaw takes the shorter difference), with ``y_m`` the measured coordinates of the end effector
    and ``l`` the lead. The lead keeps the reference from running away from a blocked tool, and the spring's force below
    stiffness times lead. The twist of the reference is that of the bounded motion, itself within ``v_max``. State and
    observation: ``reference_position`` ``(*B, D)``.

    Append it after an :class:`ImpedanceTransform`, where an episode-level policy has its macro step.

    Args:
        task_space: meaning of the D coordinates.
        max_velocity: one number, or D of them: the velocity that an action of 1 stands for [m/s, rad/s].
        max_lead: one number, or D of them: largest distance of the reference from the end effector [m, rad].
        dt: control step [s]; None takes it from the environment, and needs one.
        action_key: the action: velocity outside, reference towards the environment.
        pose_key: end-effector pose observation.
        heading_key: heading observation; the action is then a velocity ahead, to the left and up, in a task space of
            x, y, z. None takes the axes of the task space.

    Raises:
        ValueError: if a size does not fit, a number is not positive, or an action is not finite.

    Source:
        Paper, section "Common Experimental Setup" (variants S and ST).

    Examples:
        >>> task_space = TaskSpace(("x", "y"), (0.4, 0.0, 0.1, 0.0, 1.0, 0.0, 0.0))
        >>> CartesianVelocityTransform(task_space, max_velocity=0.3).max_velocity
        tensor([0.3000, 0.3000])
    """

    _at_control_rate = True

    def __init__(
        self,
        task_space: TaskSpace,
        *,
        max_velocity: float | Sequence[float] = 0.4,
        max_lead: float | Sequence[float] = 0.05,
        dt: float | None = None,
        action_key: NestedKey = "action",
        pose_key: NestedKey = "pose",
        heading_key: NestedKey | None = None,
    ) -> None:
        super().__init__(action_key)
        require_instance("task_space", task_space, TaskSpace, JointSpace)
        if heading_key is not None and task_space.axes != ("x", "y", "z"):
            raise ValueError(f"task_space has the coordinates {task_space.axes}; expected ('x', 'y', 'z').")
        self.heading_key = heading_key
        self.task_space = task_space
        self.pose_key = pose_key
        self.register_buffer("max_velocity", _bound("max_velocity", max_velocity, task_space.num_dof))
        self.register_buffer("max_lead", _bound("max_lead", max_lead, task_space.num_dof))
        self.dt = dt

    @property
    def _readings(self) -> tuple[NestedKey, ...]:
        return (self.pose_key,) if self.heading_key is None else (self.pose_key, self.heading_key)

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        (action,) = self._require(tensordict, self.action_key)
        (pose,) = self._recall(tensordict, self.pose_key)
        require_last_dim("action (Cartesian velocity)", action, self.task_space.num_dof)
        require_finite("action (Cartesian velocity)", action)
        measured = self.task_space.project(pose).to(action.dtype)
        position = self._known(tensordict, "reference_position")
        if position is None:
            position = measured
        lead, speed = self.max_lead.to(action.dtype), self.max_velocity.to(action.dtype)
        asked = speed * action.clamp(-1.0, 1.0)
        if self.heading_key is not None:
            asked = from_heading(asked, *self._recall(tensordict, self.heading_key))
        dt = self.dt
        wanted = position + dt * asked
        following = measured + self.task_space.difference(wanted, measured).clamp(-lead, lead)
        # A moving tool may pull the reference along faster than v_max; its twist stays within v_max all the same.
        velocity = (self.task_space.difference(following, position) / dt).clamp(-speed, speed)
        reference = torch.cat([self.task_space.pose(following), self.task_space.twist(velocity)], -1)
        tensordict.set(self.action_key, reference)
        self._stash(tensordict, "reference_position", following)
        return tensordict

    def _after_step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        self._unstash(tensordict, next_tensordict, "reference_position")
        return next_tensordict

    def _after_reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        (pose,) = self._require(tensordict_reset, self.pose_key)
        position = self.task_space.project(pose).to(self._like().dtype)
        self._restart(tensordict, tensordict_reset, "reference_position", position)
        return tensordict_reset

    def _state_specs(self, batch: torch.Size, like: TensorSpec) -> dict[NestedKey, TensorSpec]:
        return {"reference_position": real(like, *like.shape[:-1], self.task_space.num_dof)}

    def transform_action_spec(self, action_spec: Composite) -> Composite:
        """Outside, the action is a velocity of D numbers in [-1, 1]."""
        like = action_spec[self.action_key]
        shape = (*like.shape[:-1], self.task_space.num_dof)
        spec = Bounded(-1.0, 1.0, shape=shape, dtype=like.dtype, device=like.device)
        return replace_leaf(action_spec, self.action_key, spec, type(self).__name__)


def _bound(name: str, value: float | Sequence[float], size: int) -> Tensor:
    try:
        bound = torch.as_tensor(value, dtype=torch.get_default_dtype()).reshape(-1)
    except (TypeError, ValueError, RuntimeError):
        bound = torch.empty(0)
    if bound.numel() not in (1, size) or not bool((bound > 0).all() & bound.isfinite().all()):
        raise ValueError(f"{name} is {value}; expected 1 or {size} positive numbers.")
    return bound.expand(size).clone()
