"""The energy tank as a transform of an effort action."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey, unravel_key_list
from torch import Tensor
from torchrl.data import Bounded, TensorSpec

from ppt_rl.functional.checks import require_positive
from ppt_rl.functional.energy_tank import TANK_LAWS, law_reads
from ppt_rl.functional.limits import EffortBounds, scale_into
from ppt_rl.functional.tank_ahead import recent_motion
from ppt_rl.functional.tank_laws import beside
from ppt_rl.modules.kinematics import Kinematics
from ppt_rl.transforms.chain import transforms_after
from ppt_rl.transforms.flow import flow_of_size, same_shape
from ppt_rl.transforms.joint_torque import JointTorqueTransform
from ppt_rl.transforms.specs import real
from ppt_rl.transforms.step_limits import StepLimitsTransform
from ppt_rl.transforms.tank_account import TankAccountTransform
from ppt_rl.transforms.tank_inputs import (
    beside_key,
    passing_part,
    require_inertia,
    require_keys,
    require_law,
    require_read,
    require_result,
)
from ppt_rl.transforms.timed import TimedTransform

__all__ = ["EnergyTankTransform"]

#: Velocities that an effort may work on.
_FLOWS = ("twist", "joint_velocity")
#: Where the bounds of the action are stored on the parent, which belongs to this transform alone.
_BOUNDS = "_bounds_of_effort"


class EnergyTankTransform(TimedTransform, StepLimitsTransform, TankAccountTransform):
    r"""Scales an effort action so that its power and its total work stay within a budget.

    .. math::
        \gamma &= \min\Big(1,\ \frac{P_{max}}{\max(\epsilon, p)},\ \frac{E}{\Delta t \max(\epsilon, p)}\Big),
        \quad p = |\mathrm{effort} \cdot \mathrm{flow}| \\
        E' &= \mathrm{clip}(E - \gamma\, p\, \Delta t,\ 0,\ E_{max})

    This is the law of ``mode="paper"``. Its state is two observations, each ``(*B, 1)``: the level ``tank_energy`` [J]
    and ``valve`` [-], the factor on the last effort. There are other laws, and more can be registered in
    :data:`~ppt_rl.functional.energy_tank.TANK_LAWS`:

    * ``"passive"`` (:func:`~ppt_rl.functional.tank_laws.passive_tank`): braking passes and refills the tank. The bounds
      are those of ``effort . flow`` with its sign: net energy, and no limit on the power of braking.
    * ``"parallel"`` (:func:`~ppt_rl.functional.tank_laws.parallel_tank`): damping passes beside the valve, as long as
      it brakes; ``inertia`` looks ahead here too. An :class:`ImpedanceTransform` with the same ``damping_key`` writes
      it, and a :class:`JointTorqueTransform` in between carries it to joint space.
    * ``"rate"`` (:func:`~ppt_rl.functional.tank_ahead.rate_tank`): the power counts at every moment of the control step
      over which the effort is held, with the velocity that the effort itself adds, by ``inertia``.
    * ``"impact"`` (:func:`~ppt_rl.functional.tank_ahead.impact_tank`): the same, whatever passive contact does to the
      velocity in the step. It needs the inertia of the whole arm, so it belongs at the motors. What contact may hold
      (:func:`~ppt_rl.functional.tank_ahead.recent_motion`) is one more state, ``tank_energy_held`` ``(*B, 1)`` [J].

    Where the tank stands in the chain decides what it guarantees:

    * **First in the list, right at the environment** (joint torque, joint velocity): it bounds what is executed. It
      scales the torque into the bounds of the environment's action (:func:`~ppt_rl.functional.limits.scale_into`; the
      factor is part of ``valve``), and meters and scales the result, posture torque included. At every control step
      ``|torque . joint_velocity| <= p_max``, and over an episode ``sum |torque . joint_velocity| dt <= e_max``.
    * **After a** :class:`JointTorqueTransform` (wrench, twist): the paper's tank. It bounds the nominal power of the
      task's wrench. Posture torque and torque limits come later, so it says nothing about the torque that is executed.

    Both count the velocity observed when the action is chosen as constant over the control step. What the velocity does
    within the step is beyond them; ``EngineConfig(audit=True)`` measures it, ``mode="rate"`` counts the part that the
    effort causes, and ``mode="impact"`` also what contact causes. Append a tank before a :class:`MacroStepTransform`.

    With ``p_max_key`` or ``e_max_key``, a policy or a schedule gives limits per step, ``(*B, 1)``, in [0, ``p_max``]
    and [0, ``e_max``]; what lies outside is clamped to these hard bounds. A higher capacity does not fill the tank, a
    lower one clips its level. Unless the environment already observes that key, the limit is part of the tank's state:
    it begins at its hard bound and holds until it is written anew, over the control steps of a macro step too.

    In a simulator the tank keeps its own level, which no policy and no later transform reaches. A higher level in the
    tensordict is refused, so energy does not come back by stepping again from an old tensordict; a lower one counts. An
    environment that has its whole state in the tensordict (not batch-locked, or with the attribute
    ``state_in_tensordict = True``) may be stepped again from any of them.

    Args:
        p_max: power limit [W].
        e_max: capacity of the tank, and its level at the start of an episode [J].
        dt: control step [s]; None takes it from the environment, and needs one.
        mode: name of the law; ``"paper"`` charges braking like pushing and never refills.
        inertia: what the effort accelerates, for a law that reads it: a number for each axis or a matrix, a lower bound
            of the true one [kg, kg m^2]; or, for joint torque, the arm's kinematics, which compute its matrix from
            ``joint_position`` at every step (without its tool, so it is a lower bound too). ``"rate"`` and ``"impact"``
            need it, and without it ``"passive"`` and ``"parallel"`` are not passive in the closed loop.
        effort_key: the action: a wrench [N, N m] or joint torque [N m].
        flow_key: the observed velocity that it works on; None takes ``twist`` or ``joint_velocity``, whichever has the
            action's size. Where both have it, as with an arm of six joints, say which.
        eps: smallest power that is divided by [W].
        damping_key: the damping part of the action, for a law that reads it.
        p_max_key: power limit of the step ``(*B, 1)`` [W]; None takes ``p_max`` always.
        e_max_key: capacity from the step on ``(*B, 1)`` [J]; None takes ``e_max`` always.
        position_key: the position q whose rate ``flow_key`` is, such as ``joint_position``. With it the level is
            settled after each step: what the held effort delivered, ``effort . (q' - q)``, is paid where it is more
            than the law's price, and what the level cannot pay stays as a debt, the state ``tank_energy_debt``
            ``(*B, 1)`` [J]. So the net energy of an episode is at most ``E_0 - E + debt``. None takes the law's price.
        out_keys: where the level and the valve are written. A second tank in the same chain needs others.

    Raises:
        ValueError: if a number is out of range, the mode is unknown, its law lacks what it reads or is given what it
            does not, an input is not finite, the flow is ambiguous or of another shape, the tank stands after a macro
            step, another tank writes the same keys, a later transform overwrites the level, the bounds of the action
            exclude zero, or the level is above the tank's own.
        KeyError: if no flow or damping is found, or no level or limit in an environment.

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
        *,
        inertia: Sequence[float] | Tensor | Kinematics | None = None,
        damping_key: NestedKey | None = None,
        p_max_key: NestedKey | None = None,
        e_max_key: NestedKey | None = None,
        position_key: NestedKey | None = None,
    ) -> None:
        super().__init__(effort_key)
        require_keys(out_keys, p_max_key, e_max_key)
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
        require_law(mode, self.law)
        require_read(mode, self.law, damping_key, inertia)
        self.kinematics = inertia if isinstance(inertia, Kinematics) else None
        constant = None if inertia is None or isinstance(inertia, Kinematics) else require_inertia(inertia)
        self.register_buffer("inertia", constant, persistent=False)
        self.flow_key, self.damping_key, self.p_max_key, self.e_max_key = flow_key, damping_key, p_max_key, e_max_key
        self.out_keys = list(out_keys)
        self.energy_key, self.valve_key = out_keys
        self.position_key = position_key
        self.held_key = beside_key(self.energy_key, "held") if "stored" in law_reads(self.law) else None

    @property
    def _readings(self) -> tuple[NestedKey, ...]:
        flows = _FLOWS if self.flow_key is None else (self.flow_key,)
        configuration = () if self.kinematics is None else ("joint_position",)
        settled = () if self.position_key in (None, *configuration) else (self.position_key,)
        return (*flows, *configuration, *settled)

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        (effort,) = self._require(tensordict, self.action_key)
        if not effort.is_floating_point():
            raise ValueError(f"action {self.action_key!r} is of {effort.dtype}; expected a floating-point effort.")
        flow = self._flow(tensordict, effort)
        energy = self._level(tensordict, effort)
        bounds = self._bounds()
        effort, factor = (effort, None) if bounds is None else scale_into(effort, bounds)
        p_max = self._limit(tensordict, self.p_max_key, self.p_max, effort)
        e_max = self._limit(tensordict, self.e_max_key, self.e_max, effort)
        read: dict[str, Tensor] = {}
        if self.kinematics is not None:
            read["inertia"] = self.kinematics.inertia(*self._recall(tensordict, "joint_position"))
        elif self.inertia is not None:
            read["inertia"] = self.inertia.to(effort)
        if self.held_key is not None:
            before = self._known(tensordict, self.held_key)
            read["stored"] = recent_motion(flow, read["inertia"], before, dt=self.dt)
            self._stash(tensordict, self.held_key, read["stored"])
        if self.damping_key is not None:
            (damping,) = self._require(tensordict, self.damping_key)
            read["damping"] = passing_part(
                self.damping_key, damping, effort, flow, bounds, factor, inertia=read.get("inertia"), dt=self.dt
            )
        step = self.law(effort, flow, energy, p_max=p_max, e_max=e_max, dt=self.dt, eps=self.eps, **read)
        step = require_result(self.mode, self.law, step, energy, self.e_max)
        executed = beside(step.valve, effort, read["damping"]) if "damping" in read else step.valve * effort
        tensordict.set(self.action_key, executed)
        self._hold(tensordict, executed)
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

    # -- bounds -------------------------------------------------------------------------------------------------------

    def _bounds(self) -> EffortBounds | None:
        """Bounds of the action towards the environment, if it has any."""
        parent = self.parent
        if parent is None:
            return None
        if _BOUNDS not in parent.__dict__:
            spec = self._like()
            with torch.inference_mode(False):  # cached, so used outside of it too
                bounds = EffortBounds.of(spec.space.low, spec.space.high) if isinstance(spec, Bounded) else None
            parent.__dict__[_BOUNDS] = bounds
        return parent.__dict__[_BOUNDS]

    # -- state --------------------------------------------------------------------------------------------------------

    def _after_step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        for key in self._first():
            if key != self.debt_key:
                self._unstash(tensordict, next_tensordict, key)
        self._settle(tensordict, next_tensordict)
        return next_tensordict

    def _after_reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        zeros = self._zeros(self._state_specs(self.parent.batch_size, self._like()), tensordict_reset)
        for key, value in self._first().items():
            self._restart(tensordict, tensordict_reset, key, zeros[key] + value)
        return tensordict_reset

    def _first(self) -> dict[NestedKey, float]:
        """The state at the start of an episode."""
        further = {key: 0.0 for key in (self.held_key, self.debt_key) if key is not None}
        return {self.energy_key: self.e_max, self.valve_key: 1.0, **self._held(), **further}

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
        if self.damping_key is not None:
            self._check_damping()
        bounds = self._bounds()
        if bounds is not None and (bool((bounds.low > 0).any()) or bool((bounds.high < 0).any())):
            raise ValueError(
                f"the action {self.action_key!r} has bounds that exclude zero; expected low <= 0 <= high, since a "
                "closed valve sends zero. Shift the action before the tank."
            )

    def _check_damping(self) -> None:
        """Refuse a transform that turns the wrench into a torque and leaves its damping a wrench."""
        keys = [other.damping_key for other in transforms_after(self) if isinstance(other, JointTorqueTransform)]
        if any(key != self.damping_key for key in keys):
            raise ValueError(
                f"damping_key is {self.damping_key!r}, but the JointTorqueTransform after the tank has {keys[0]!r}; "
                f"expected the same, so that it carries the damping to joint space. Pass it {self.damping_key!r} too."
            )

    def _state_specs(self, batch: torch.Size, like: TensorSpec) -> dict[NestedKey, TensorSpec]:
        def column(high: float) -> Bounded:
            return Bounded(0.0, high, shape=(*like.shape[:-1], 1), dtype=like.dtype, device=like.device)

        limits = {key: column(most) for key, most in self._held().items()}
        further = {key: real(like, *like.shape[:-1], 1) for key in (self.held_key, self.debt_key) if key is not None}
        return {self.energy_key: column(self.e_max), self.valve_key: column(1.0), **limits, **further}
