"""Governing a reference so that the impedance that follows it does not push harder than a limit."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite, TensorSpec

from ppt_rl.functional.argument_checks import require_instance, require_numbers
from ppt_rl.functional.checks import require_finite, require_last_dim, require_positive
from ppt_rl.functional.reference_governor import govern_reference
from ppt_rl.modules.impedance import CartesianImpedanceController
from ppt_rl.transforms.base import ActionTransform
from ppt_rl.transforms.chain import transforms_of
from ppt_rl.transforms.impedance import ImpedanceTransform
from ppt_rl.transforms.specs import real
from ppt_rl.transforms.timed import TimedTransform

__all__ = ["ReferenceGovernorTransform"]

#: Where the controller is stored on the parent, which belongs to one transform alone.
_CONTROLLER = "_controller_of_governor"


class ReferenceGovernorTransform(TimedTransform, ActionTransform):
    r"""Changes a reference ``(*B, 13)``, pose and twist, so that the impedance does not push harder than a limit.

    .. math:: \lVert K\,(x_d - x) + D\,v_d \rVert \le f_{max}, \qquad
        \lVert K_R\,e_R + D_R\,\omega_d \rVert \le \tau_{max}

    with the gains of the controller: spring and feed-forward together stay within a limit
    (:func:`~ppt_rl.functional.reference_governor.limit_drive`). So this is the force of the impedance on a tool that is
    held still, whatever reference a policy or a primitive asks for. An energy tank bounds no force, because a tool that
    stands still takes no power.

    The governor also lets go in time. While the governed reference lags behind the one that is asked for, it moves by
    at most ``catch_up_speed * dt`` a control step (besides being drawn towards the tool), so a tool that comes free
    does not leap. Away from its limits the reference passes unchanged, bit by bit.

    State and observations: ``governed_pose`` ``(*B, 7)``, and ``governor_lag`` ``(*B, 2)`` [m, rad], the distance
    and the angle from there to the pose that was asked for, zero where the reference passes unchanged.

    What it does not bound: the damper's braking force ``-D v``, the impact of the moving arm's inertia, the posture
    torque, and what the tool does within a control step. Append it after an :class:`ImpedanceTransform` and before a
    :class:`MacroStepTransform`.

    Args:
        f_max: largest drive in translation [N].
        torque_max: largest drive in rotation [N m].
        catch_up_speed: largest speed of the governed pose while it lags: one number [m/s], or two [m/s, rad/s];
            of one number, rotation gets 4 rad/m times that.
        with_motion: whether the force that the damper takes to keep up the measured motion comes on top of the limit.
            Without it, the arm moves steadily at no more than ``f_max / d``; with it, the limit on a tool that is
            held still is the same.
        controller: the law whose drive is bounded; None takes that of the :class:`ImpedanceTransform` in the chain.
        dt: control step [s]; None takes it from the environment, and needs one.
        action_key: the action: reference outside, governed reference towards the environment.
        reading_keys: end-effector pose and twist observations.

    Raises:
        ValueError: if a number is out of range, the reference has another size than 13 or is not finite, there is no
            controller, the chain's controller has other gains than the given one, or the governor stands after a macro
            step.
        KeyError: if an observation is missing.

    Examples:
        >>> from tensordict import TensorDict
        >>> governor = ReferenceGovernorTransform(20.0, controller=CartesianImpedanceController(400.0), dt=0.01)
        >>> pose = torch.tensor([0.4, 0.0, 0.1, 0.0, 1.0, 0.0, 0.0])
        >>> far = torch.cat([pose, torch.zeros(6)])
        >>> far[0] += 1.0
        >>> governed = governor.inv(TensorDict(action=far, pose=pose, twist=torch.zeros(6)))["action"]
        >>> round(400.0 * float(governed[0] - pose[0]), 2)
        20.0
    """

    _at_control_rate = True

    def __init__(
        self,
        f_max: float = 20.0,
        torque_max: float = 10.0,
        *,
        catch_up_speed: float | Sequence[float] = 0.25,
        with_motion: bool = False,
        controller: CartesianImpedanceController | None = None,
        dt: float | None = None,
        action_key: NestedKey = "action",
        reading_keys: tuple[NestedKey, NestedKey] = ("pose", "twist"),
    ) -> None:
        super().__init__(action_key)
        self.limits = require_positive("f_max", f_max, "N"), require_positive("torque_max", torque_max, "N m")
        speeds = require_numbers("catch_up_speed", catch_up_speed, (1, 2), low=1e-6, unit="m/s, rad/s").tolist()
        self.speeds = (speeds[0], speeds[1] if len(speeds) > 1 else 4.0 * speeds[0])
        require_instance("with_motion", with_motion, bool)
        require_instance("controller", controller, CartesianImpedanceController, type(None))
        if not isinstance(reading_keys, tuple) or len(reading_keys) != 2:
            raise ValueError(f"reading_keys is {reading_keys!r}; expected two keys, of pose and twist.")
        self.with_motion = with_motion
        self.controller = controller
        self.pose_key, self.twist_key = reading_keys
        self.dt = dt

    @property
    def _readings(self) -> tuple[NestedKey, ...]:
        return (self.pose_key, self.twist_key) if self.with_motion else (self.pose_key,)

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        (reference,) = self._require(tensordict, self.action_key)
        pose, *twist = self._recall(tensordict, *self._readings)
        require_last_dim("reference (pose and twist)", reference, 13)
        require_finite("reference (pose and twist)", reference)
        last, lag = (self._known(tensordict, key) for key in ("governed_pose", "governor_lag"))
        controller = self._controller()
        governed = govern_reference(
            reference, pose.to(reference.dtype), controller.stiffness.to(reference.dtype),
            controller.damping.to(reference.dtype), reference[..., :7] if last is None else last,
            torch.zeros_like(reference[..., :2]) if lag is None else lag, limits=self.limits, speeds=self.speeds,
            dt=self.dt, moving=twist[0].to(reference.dtype) if twist else None,
        )  # fmt: skip
        self._stash(tensordict, "governed_pose", governed.pose)
        self._stash(tensordict, "governor_lag", governed.lag)
        return tensordict.set(self.action_key, torch.cat([governed.pose, governed.twist], -1))

    def _controller(self) -> CartesianImpedanceController:
        """The given controller, else that of the chain."""
        if self.controller is not None:
            return self.controller
        found = None if self.parent is None else self.parent.__dict__.get(_CONTROLLER) or self._chains()
        if found is None:
            raise ValueError(
                "ReferenceGovernorTransform has no controller, and finds no ImpedanceTransform towards the "
                "environment; expected one of them. Append it after an ImpedanceTransform, or pass controller=."
            )
        if self.parent is not None:
            self.parent.__dict__[_CONTROLLER] = found
        return found

    def _chains(self) -> CartesianImpedanceController | None:
        """The controller of the impedance in the chain, if there is one."""
        chain = (t for t in transforms_of(self.parent) if isinstance(t, ImpedanceTransform))
        return next((transform.controller for transform in chain), None)

    def _check_place(self) -> None:
        super()._check_place()
        controller, chains = self._controller(), self._chains()
        if chains is None or chains is controller:
            return
        if not all(torch.allclose(*_pair(controller, chains, name)) for name in ("stiffness", "damping")):
            raise ValueError(
                "the controller of ReferenceGovernorTransform has other gains than that of the ImpedanceTransform in "
                "the chain; expected the same. Leave controller= out."
            )

    # -- state and specs ----------------------------------------------------------------------------------------------

    def _after_step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        self._unstash(tensordict, next_tensordict, "governed_pose")
        self._unstash(tensordict, next_tensordict, "governor_lag")
        return next_tensordict

    def _after_reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        (pose,) = self._require(tensordict_reset, self.pose_key)
        zeros = self._zeros(self._state_specs(self.parent.batch_size, self._like()), tensordict_reset)
        self._restart(tensordict, tensordict_reset, "governed_pose", pose.to(self._like().dtype))
        self._restart(tensordict, tensordict_reset, "governor_lag", zeros["governor_lag"])
        return tensordict_reset

    def _state_specs(self, batch: torch.Size, like: TensorSpec) -> dict[NestedKey, TensorSpec]:
        lead = like.shape[:-1]
        return {"governed_pose": real(like, *lead, 7), "governor_lag": real(like, *lead, 2)}

    def transform_action_spec(self, action_spec: Composite) -> Composite:
        """Outside, the action is a reference of the same shape."""
        require_last_dim(f"the action {self.action_key!r}", action_spec[self.action_key].zero(), 13)
        return action_spec


def _pair(one: CartesianImpedanceController, other: CartesianImpedanceController, name: str) -> tuple[Tensor, Tensor]:
    """The same gain of two controllers, in single precision."""
    return getattr(one, name).detach().float(), getattr(other, name).detach().float()
