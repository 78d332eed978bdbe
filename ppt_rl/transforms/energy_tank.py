"""The energy tank as a transform of an effort action."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey, expand_as_right, unravel_key_list
from torch import Tensor
from torchrl.data import Bounded, TensorSpec

from ppt_rl.functional.checks import require_all, require_finite, require_positive
from ppt_rl.functional.energy_tank import TANK_LAWS
from ppt_rl.functional.limits import EffortBounds, scale_into
from ppt_rl.transforms.base import ActionTransform
from ppt_rl.transforms.chain import transforms_after
from ppt_rl.transforms.flow import flow_of_size, same_shape
from ppt_rl.transforms.timed import TimedTransform

__all__ = ["EnergyTankTransform"]

#: Velocities that an effort may work on.
_FLOWS = ("twist", "joint_velocity")
#: Largest difference between the level in the tensordict and the tank's own, as a share of the capacity [-].
_SAME_LEVEL = 1e-5
#: Where the bounds of the action are stored on the parent, which belongs to this transform alone.
_BOUNDS = "_bounds_of_effort"


class EnergyTankTransform(TimedTransform, ActionTransform):
    r"""Scales an effort action so that its power and its total work stay within a budget.

    .. math::
        \gamma &= \min\Big(1,\ \frac{P_{max}}{\max(\epsilon, p)},\ \frac{E}{\Delta t \max(\epsilon, p)}\Big),
        \quad p = |\mathrm{effort} \cdot \mathrm{flow}| \\
        E' &= \mathrm{clip}(E - \gamma\, p\, \Delta t,\ 0,\ E_{max})

    This is the law of ``mode="paper"``; others are registered in :data:`~ppt_rl.functional.energy_tank.TANK_LAWS`. Its
    state is two observations, each ``(*B, 1)``: the level ``tank_energy`` [J] and ``valve`` [-], the factor on the last
    effort.

    Where the tank stands in the chain decides what it guarantees:

    * **First in the list, right at the environment** (joint torque, joint velocity): it bounds what is executed. It
      scales the torque into the bounds of the environment's action (:func:`~ppt_rl.functional.limits.scale_into`; the
      factor is part of ``valve``), and meters and scales the result, posture torque included. At every control step
      ``|torque . joint_velocity| <= p_max``, and over an episode ``sum |torque . joint_velocity| dt <= e_max``.
    * **After a** :class:`JointTorqueTransform` (wrench, twist): the paper's tank. It bounds the nominal power of the
      task's wrench. Posture torque and torque limits come later, so it says nothing about the torque that is executed.

    Both count the velocity observed when the action is chosen as constant over the control step. What the velocity does
    within the step is beyond them; ``EngineConfig(audit=True)`` measures it. Append a tank before a
    :class:`MacroStepTransform`, never after.

    In a simulator the tank keeps its own level, which no policy and no later transform reaches. A higher level in the
    tensordict is refused, so energy does not come back by stepping again from an old tensordict; a lower one counts. An
    environment that has its whole state in the tensordict (not batch-locked, or with the attribute
    ``state_in_tensordict = True``) may be stepped again from any of them.

    Args:
        p_max: power limit [W].
        e_max: capacity of the tank, and its level at the start of an episode [J].
        dt: control step [s]; None takes it from the environment, and needs one.
        mode: name of the law; ``"paper"`` charges braking like pushing and never refills.
        effort_key: the action: a wrench [N, N m] or joint torque [N m].
        flow_key: the observed velocity that it works on; None takes ``twist`` or ``joint_velocity``, whichever has the
            action's size. Where both have it, as with an arm of six joints, say which.
        eps: smallest power that is divided by [W].
        out_keys: where the level and the valve are written. A second tank in the same chain needs others.

    Raises:
        ValueError: if a number is out of range, the mode is unknown, an input is not finite, the flow is ambiguous or
            of another shape, the tank stands after a macro step, another tank writes the same keys, a later transform
            overwrites the level, the bounds of the action exclude zero, or the level is above the tank's own.
        KeyError: if no flow is found, or no level in an environment.

    Source:
        Paper, eq. (10) and section "Energy-Tank Layer for Safe Execution".

    Examples:
        >>> from torchrl.envs import TransformedEnv
        >>> from torchrl.envs.custom import PendulumEnv
        >>> env = TransformedEnv(PendulumEnv(), EnergyTankTransform(dt=0.05, flow_key="thdot"))
        >>> bool((env.rollout(5)["next", "valve"] <= 1).all())
        True
    """

    _at_control_rate = True
    _keeps_copies = True

    def __init__(
        self,
        p_max: float = 2.0,
        e_max: float = 3.0,
        dt: float | None = None,
        mode: str = "paper",
        effort_key: NestedKey = "action",
        flow_key: NestedKey | None = None,
        eps: float = 1e-6,
        out_keys: tuple[NestedKey, NestedKey] = ("tank_energy", "valve"),
    ) -> None:
        super().__init__(effort_key)
        if len(out_keys) != 2 or out_keys[0] == out_keys[1]:
            raise ValueError(f"out_keys are {out_keys}; expected two: where the level and the valve are written.")
        if mode not in TANK_LAWS:
            raise ValueError(
                f"mode is {mode!r}; expected one of {list(TANK_LAWS)}. A law of your own is registered in "
                "ppt_rl.functional.energy_tank.TANK_LAWS."
            )
        self.p_max = require_positive("p_max", p_max, "W")
        self.e_max = require_positive("e_max", e_max, "J")
        self.dt = dt
        self.eps = require_positive("eps", eps, "W")
        self.mode, self.law = mode, TANK_LAWS[mode]
        self.flow_key = flow_key
        self.out_keys = list(out_keys)
        self.energy_key, self.valve_key = out_keys

    @property
    def _readings(self) -> tuple[NestedKey, ...]:
        return _FLOWS if self.flow_key is None else (self.flow_key,)

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        (effort,) = self._require(tensordict, self.action_key)
        if not effort.is_floating_point():
            raise ValueError(f"action {self.action_key!r} is of {effort.dtype}; expected a floating-point effort.")
        flow = self._flow(tensordict, effort)
        energy = self._level(tensordict, effort)
        bounds = self._bounds()
        effort, factor = (effort, None) if bounds is None else scale_into(effort, bounds)
        step = self.law(effort, flow, energy, p_max=self.p_max, e_max=self.e_max, dt=self.dt, eps=self.eps)
        tensordict.set(self.action_key, step.valve * effort)
        self._stash(tensordict, self.energy_key, step.energy)
        self._stash(tensordict, self.valve_key, step.valve if factor is None else step.valve * factor)
        return tensordict

    def _flow(self, tensordict: TensorDictBase, effort: Tensor) -> Tensor:
        if self.flow_key is not None:
            (flow,) = self._recall(tensordict, self.flow_key)
            return same_shape(self.flow_key, flow, self.action_key, effort)
        flows = {key: self._known(tensordict, key) for key in _FLOWS}
        key, flow = flow_of_size(flows, self.action_key, effort.shape[-1], tensordict)
        return same_shape(key, flow, self.action_key, effort)

    # -- level --------------------------------------------------------------------------------------------------------

    def _level(self, tensordict: TensorDictBase, effort: Tensor) -> Tensor:
        """The level at the beginning of the step ``(*B, 1)`` [J]; without an environment, a missing one is full."""
        given = tensordict.get(self.energy_key, None)
        if given is None:
            if self.parent is None:
                return torch.full_like(effort[..., :1], self.e_max)
            raise KeyError(
                f"EnergyTankTransform finds no level {self.energy_key!r} in the tensordict; expected the one that "
                "reset or the last step returned. Step from their tensordict, and select this entry too."
            )
        own = self._remembered(tensordict, self.energy_key)
        if own is not None and own.device.type == "cpu" and torch.equal(given, own):
            return own
        most, rows = self.e_max if own is None else own, self._stepping(tensordict)
        if given.shape != (*effort.shape[:-1], 1):
            raise ValueError(
                f"the level {self.energy_key!r} has shape {tuple(given.shape)}; expected {(*effort.shape[:-1], 1)}."
            )
        require_finite(str(self.energy_key), given)
        require_all(given >= 0, f"the level {self.energy_key!r} is negative; expected 0 to {self.e_max} J.")
        lawful = given <= most + _SAME_LEVEL * self.e_max
        require_all(
            lawful if rows is None else lawful | ~expand_as_right(rows, lawful),
            f"the level {self.energy_key!r} in the tensordict is above the tank's own, which is at most "
            f"e_max={self.e_max} J; expected the one that reset or the last step returned. Step from that one.",
        )
        return given if own is None else torch.minimum(given, own)

    # -- bounds -------------------------------------------------------------------------------------------------------

    def _bounds(self) -> EffortBounds | None:
        """Bounds of the action towards the environment, if it has any."""
        parent = self.parent
        if parent is None:
            return None
        if _BOUNDS not in parent.__dict__:
            spec = self._like()
            bounds = EffortBounds.of(spec.space.low, spec.space.high) if isinstance(spec, Bounded) else None
            parent.__dict__[_BOUNDS] = bounds
        return parent.__dict__[_BOUNDS]

    # -- state --------------------------------------------------------------------------------------------------------

    def _after_step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        self._unstash(tensordict, next_tensordict, self.energy_key)
        self._unstash(tensordict, next_tensordict, self.valve_key)
        return next_tensordict

    def _after_reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        zeros = self._zeros(self._state_specs(self.parent.batch_size, self._like()), tensordict_reset)
        for key, level in ((self.energy_key, self.e_max), (self.valve_key, 1.0)):
            self._restart(tensordict, tensordict_reset, key, zeros[key] + level)
        return tensordict_reset

    # -- specs --------------------------------------------------------------------------------------------------------

    def _check_place(self) -> None:
        super()._check_place()
        taken = [key for key in self.out_keys if key in self.parent.full_observation_spec.keys(True, True)]
        if taken:
            raise ValueError(
                f"out_keys are {self.out_keys}, but the environment already writes {taken}, as another "
                "EnergyTankTransform does; expected keys of its own. Pass other out_keys=, such as "
                "('joint_tank_energy', 'joint_valve')."
            )
        later = [
            type(other).__name__
            for other in transforms_after(self)
            if not isinstance(other, EnergyTankTransform) and self.energy_key in unravel_key_list(other.out_keys or [])
        ]
        if later:
            raise ValueError(
                f"{later} would overwrite the level {self.energy_key!r} of the tank; expected it unchanged. Give them "
                "out_keys of their own, and let the policy read those."
            )
        bounds = self._bounds()
        if bounds is not None and (bool((bounds.low > 0).any()) or bool((bounds.high < 0).any())):
            raise ValueError(
                f"the action {self.action_key!r} has bounds that exclude zero; expected low <= 0 <= high, since a "
                "closed valve sends zero. Shift the action before the tank."
            )

    def _state_specs(self, batch: torch.Size, like: TensorSpec) -> dict[NestedKey, TensorSpec]:
        def column(high: float) -> Bounded:
            return Bounded(0.0, high, shape=(*like.shape[:-1], 1), dtype=like.dtype, device=like.device)

        return {self.energy_key: column(self.e_max), self.valve_key: column(1.0)}
