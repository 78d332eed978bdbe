"""The energy tank as a transform of an effort action."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Bounded, TensorSpec

from ppt_rl.functional.checks import require_positive
from ppt_rl.functional.energy_tank import TANK_LAWS
from ppt_rl.transforms.base import ActionTransform
from ppt_rl.transforms.timed import TimedTransform

__all__ = ["EnergyTankTransform"]

#: Velocities that an effort may work on, in the order in which they are tried.
_FLOWS = ("twist", "joint_velocity")


class EnergyTankTransform(TimedTransform, ActionTransform):
    r"""Scales an effort action so that its power and its total work stay within a budget.

    .. math::
        \gamma &= \min\Big(1,\ \frac{P_{max}}{\max(\epsilon, p)},\ \frac{E}{\Delta t \max(\epsilon, p)}\Big),
        \quad p = |\mathrm{effort} \cdot \mathrm{flow}| \\
        E' &= \mathrm{clip}(E - \gamma\, p\, \Delta t,\ 0,\ E_{max})

    It must act at control rate: append it before a :class:`MacroStepTransform`, never after. It writes two observations
    that are also its state: ``tank_energy`` [J], the level, and ``valve``, the last factor, each ``(*B, 1)``. The power
    is nominal: the flow is the one observed when the action is chosen, held for one control step.

    Args:
        p_max: power limit [W].
        e_max: tank capacity, and level at the start of an episode [J].
        dt: control step [s]; None takes it from the environment, and needs one.
        mode: the law; ``"paper"`` charges braking like pushing and never refills.
        effort_key: the action: a wrench [N, N m] or joint torque [N m].
        flow_key: the velocity it works on, an observation; None takes ``twist`` or ``joint_velocity``, whichever has
            the action's size.
        eps: smallest power that is divided by [W].
        out_keys: where the level and the valve are written.

    Raises:
        ValueError: if a number is out of range, the mode is unknown, or an input is not finite.
        KeyError: if no flow is found.

    Source:
        Paper, eq. (10) and section "Energy-Tank Layer for Safe Execution".

    Examples:
        >>> from torchrl.envs import TransformedEnv
        >>> from torchrl.envs.custom import PendulumEnv
        >>> env = TransformedEnv(PendulumEnv(), EnergyTankTransform(dt=0.05, flow_key="thdot"))
        >>> bool((env.rollout(5)["next", "valve"] <= 1).all())
        True
    """

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
        if len(out_keys) != 2:
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

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        (effort,) = self._require(tensordict, self.action_key)
        flow = self._flow(tensordict, effort)
        energy = tensordict.get(self.energy_key, None)
        if energy is None:
            energy = torch.full_like(effort[..., :1], self.e_max)
        step = self.law(effort, flow, energy, p_max=self.p_max, e_max=self.e_max, dt=self.dt, eps=self.eps)
        tensordict.set(self.action_key, step.valve * effort)
        self._stash(tensordict, self.energy_key, step.energy)
        self._stash(tensordict, self.valve_key, step.valve)
        return tensordict

    def _flow(self, tensordict: TensorDictBase, effort: Tensor) -> Tensor:
        size = effort.shape[-1]
        if self.flow_key is not None:
            (flow,) = self._require(tensordict, self.flow_key)
            if size == 1 and flow.shape == effort.shape[:-1]:
                flow = flow.unsqueeze(-1)  # a scalar velocity without a trailing dimension
            return self._fitting(self.flow_key, flow, effort)
        for key in _FLOWS:
            flow = tensordict.get(key, None)
            if flow is not None and flow.shape[-1] == size:
                return self._fitting(key, flow, effort)
        present = sorted(str(k) for k in tensordict.keys(True, True))
        raise KeyError(
            f"EnergyTankTransform found no flow for the effort {self.action_key!r} of size {size}: neither of {_FLOWS} "
            f"is there with that size. Pass flow_key=, the velocity that the effort works on; there are {present}."
        )

    def _fitting(self, key: NestedKey, flow: Tensor, effort: Tensor) -> Tensor:
        if flow.shape != effort.shape:
            chunk = (
                " A chunk of efforts? Append the tank before the MacroStepTransform." if effort.ndim > flow.ndim else ""
            )
            raise ValueError(
                f"flow {key!r} has shape {tuple(flow.shape)} and effort {self.action_key!r} {tuple(effort.shape)}; "
                f"expected the same shape, so that effort . flow is a power.{chunk}"
            )
        return flow

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        self._unstash(tensordict, next_tensordict, self.energy_key)
        self._unstash(tensordict, next_tensordict, self.valve_key)
        return next_tensordict

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        zeros = self._zeros(self._state_specs(self.parent.batch_size, self._like()), tensordict_reset)
        for key, level in ((self.energy_key, self.e_max), (self.valve_key, 1.0)):
            self._restart(tensordict, tensordict_reset, key, zeros[key] + level)
        return tensordict_reset

    def _state_specs(self, batch: torch.Size, like: TensorSpec) -> dict[NestedKey, TensorSpec]:
        def column(high: float) -> Bounded:
            return Bounded(0.0, high, shape=(*like.shape[:-1], 1), dtype=like.dtype, device=like.device)

        return {self.energy_key: column(self.e_max), self.valve_key: column(1.0)}
