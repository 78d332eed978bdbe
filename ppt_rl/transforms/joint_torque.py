"""Joint torque from a wrench, with a posture in the nullspace."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite, TensorSpec

from ppt_rl.functional.argument_checks import require_in_range, require_instance, require_numbers
from ppt_rl.functional.checks import require_last_dim, require_positive
from ppt_rl.functional.constants import constant
from ppt_rl.functional.impedance import joint_torque, nullspace_torque, power
from ppt_rl.functional.limits import EffortBounds, scale_change, scale_into
from ppt_rl.modules.kinematics import Kinematics
from ppt_rl.transforms.base import ActionTransform
from ppt_rl.transforms.specs import real, replace_leaf
from ppt_rl.transforms.timed import TimedTransform

__all__ = ["JointTorqueTransform"]


class JointTorqueTransform(TimedTransform, ActionTransform):
    r"""Turns a wrench ``(*B, 6)`` into joint torque ``(*B, n)`` within the limits of the arm's n joints.

    .. math:: \tau = s\,\big(J^\top \lambda + N\,(k_q (q_0 - q) - d_q \dot q)\big)

    The limits scale the whole torque (``s`` in [0, 1], :func:`~ppt_rl.functional.limits.scale_into`), so it keeps its
    direction; so does a limit on its rate. What bounds the power of the result is an :class:`EnergyTankTransform`
    before this transform in the list.

    ``N`` projects into the nullspace, so the posture term moves the arm but not the end effector. (At rest a few
    percent of it leak through, because the projection is damped and its inertia diagonal.) An arm of six joints has no
    nullspace; its posture term is left out, whatever the arguments say. The transform also writes the commanded power
    ``wrench . twist`` ``(*B, 1)`` [W] as the observation ``power``, positive when energy leaves the robot.

    Args:
        kinematics: kinematics of the arm with its tool; the torque limits are those of its arm.
        posture: ``q_0``, n numbers [rad]; None takes the arm's home.
        posture_stiffness: ``k_q`` [N m/rad].
        posture_damping: ``d_q`` [N m s/rad]; with both zero there is no posture term.
        max_torque_rate: largest rate of change of a joint torque [N m/s]; None sets no limit. Franka's own is 1000.
        dt: control step [s], needed with a rate limit; None takes it from the environment.
        action_key: the action: wrench from outside, torque towards the environment.
        damping_key: the part of the wrench that damps, as an :class:`ImpedanceTransform` writes it beside the action;
            it becomes the torque ``s J^T damping``, for an :class:`EnergyTankTransform` on joint torque. None leaves
            it alone.

    Raises:
        ValueError: if the wrench has another size than 6, or a number is out of range.
        KeyError: if an observation is missing.

    Source:
        Paper, section "Cartesian Impedance Control" (``J^T lambda``).
    """

    def __init__(
        self,
        kinematics: Kinematics,
        *,
        posture: Sequence[float] | None = None,
        posture_stiffness: float = 10.0,
        posture_damping: float = 2.0,
        max_torque_rate: float | None = None,
        dt: float | None = None,
        action_key: NestedKey = "action",
        damping_key: NestedKey | None = None,
    ) -> None:
        super().__init__(action_key)
        require_instance("kinematics", kinematics, Kinematics)
        arm = kinematics.arm
        posture = arm.home if posture is None else posture
        if len(posture) != arm.num_joints:
            raise ValueError(f"posture has {len(posture)} numbers; expected {arm.num_joints} joint positions [rad].")
        self.kinematics = kinematics
        self.has_nullspace = arm.num_joints > 6
        self.posture_stiffness = require_in_range("posture_stiffness", posture_stiffness, 0.0, unit="N m/rad")
        self.posture_damping = require_in_range("posture_damping", posture_damping, 0.0, unit="N m s/rad")
        rate = None if max_torque_rate is None else require_positive("max_torque_rate", max_torque_rate, "N m/s")
        self.max_torque_rate, self._needs_dt = rate, rate is not None
        self.dt = dt
        self.damping_key = damping_key
        self._bounds: EffortBounds | None = None
        self.register_buffer("posture", require_numbers("posture", posture, [arm.num_joints]), persistent=False)
        self.register_buffer("joint_inertia", torch.tensor(arm.joints.inertia), persistent=False)
        self.register_buffer("torque_limit", torch.tensor(arm.joints.torque_limits), persistent=False)

    @property
    def _readings(self) -> tuple[NestedKey, ...]:
        return "joint_position", "joint_velocity", "twist"

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        (wrench,) = self._require(tensordict, self.action_key)
        (position,) = self._recall(tensordict, "joint_position")
        require_last_dim("wrench", wrench, 6)
        jacobian = self.kinematics.jacobian(position).to(wrench.dtype)
        torque = joint_torque(jacobian, wrench)
        if self.has_nullspace and (self.posture_stiffness or self.posture_damping):
            (velocity,) = self._recall(tensordict, "joint_velocity")
            spring = constant(self.posture_stiffness, position) * (self.posture.to(position) - position)
            posture = spring - constant(self.posture_damping, velocity) * velocity
            torque = torque + nullspace_torque(jacobian, posture.to(torque), self.joint_inertia.to(torque))
        torque, factor = scale_into(torque, self._limits(torque))
        if self.damping_key is not None:
            (damping,) = self._require(tensordict, self.damping_key)
            require_last_dim(f"damping {self.damping_key!r}", damping, 6)
            damping = joint_torque(jacobian, damping)
            tensordict.set(self.damping_key, damping if factor is None else factor * damping)
        tensordict.set(self.action_key, self._limited(torque, tensordict))
        if self.parent is not None:
            self._stash(tensordict, "power", power(wrench, *self._recall(tensordict, "twist")))
        return tensordict

    def _limits(self, like: Tensor) -> EffortBounds:
        """The torque limits in the precision and on the device of a torque."""
        bounds = self._bounds
        if bounds is None or bounds.low.dtype != like.dtype or bounds.low.device != like.device:
            with torch.inference_mode(False):  # cached, so used outside of it too
                limit = self.torque_limit.to(like)
                bounds = self._bounds = EffortBounds.of(-limit, limit)
        return bounds

    def _limited(self, torque: Tensor, tensordict: TensorDictBase) -> Tensor:
        """A torque within the limit on its rate."""
        if self.max_torque_rate is not None:
            last = self._known(tensordict, "torque")
            if last is not None:
                torque = scale_change(torque, last, self.max_torque_rate * self.dt)
            self._stash(tensordict, "torque", torque)
        return torque

    def _after_step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        for key in self._state_keys():
            self._unstash(tensordict, next_tensordict, key)
        return next_tensordict

    def _after_reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        zeros = self._zeros(self._state_specs(self.parent.batch_size, self._like()), tensordict_reset)
        for key, zero in zeros.items():
            self._restart(tensordict, tensordict_reset, key, zero)
        return tensordict_reset

    def _state_keys(self) -> list[str]:
        return ["power"] if self.max_torque_rate is None else ["power", "torque"]

    def _state_specs(self, batch: torch.Size, like: TensorSpec) -> dict[NestedKey, TensorSpec]:
        sizes = {"power": 1, "torque": self.kinematics.arm.num_joints}
        return {key: real(like, *like.shape[:-1], sizes[key]) for key in self._state_keys()}

    def transform_action_spec(self, action_spec: Composite) -> Composite:
        """Outside, the action is a wrench of 6 numbers."""
        like = action_spec[self.action_key]
        spec = real(like, *like.shape[:-1], 6)
        return replace_leaf(action_spec, self.action_key, spec, type(self).__name__)
