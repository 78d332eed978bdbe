"""A constraint on power or work, as a cost, a penalty or the end of an episode."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import TensorSpec

from ppt_rl.functional.argument_checks import require_in_range, require_instance
from ppt_rl.functional.impedance import power
from ppt_rl.transforms.base import Entries
from ppt_rl.transforms.observer import ObserverTransform
from ppt_rl.transforms.specs import real
from ppt_rl.transforms.timed import TimedTransform

__all__ = ["PowerLimitTransform"]


class PowerLimitTransform(TimedTransform, ObserverTransform):
    r"""Measures by how much a power exceeds a limit: that of the measured wrench, ``P = wrench . twist``, by default.

    .. math:: c = \Delta t\,\max(0, |P| - P_{max}), \qquad r' = r - \mathrm{penalty} \cdot c

    It writes the cost ``c`` ``(*B, 1)`` [J] under ``("next", "cost")``, where losses of constrained RL look for it.
    With a limit of zero the cost is the whole work, charged like a tank charges it: braking as much as pushing.
    With ``terminate`` an episode ends (``terminated``) at the first step above the limit. Unlike the
    :class:`EnergyTankTransform` it leaves the action alone: it makes the constraint part of the task.

    Append it before a :class:`MacroStepTransform`, which sums ``cost`` (under that key) over the control steps as it
    sums rewards. If it terminates episodes, append it before an :class:`EpisodeMetricsTransform` too, which has to see
    where episodes end. The penalty changes the reward of the environment only, not the entries under ``reward_terms``.

    Args:
        p_max: limit of the power [W].
        penalty: reward subtracted per joule above the limit [1/J]; zero leaves the reward alone.
        terminate: whether a step above the limit ends the episode.
        dt: control step [s]; None takes it from the environment, and needs one.
        wrench_key: measured wrench on the world.
        twist_key: measured twist.
        power_key: a power ``(*B, 1)`` [W] to take instead of the measured one, such as the commanded ``"power"`` of a
            :class:`JointTorqueTransform`; append this transform after that one.
        cost_key: where the cost is written.

    Raises:
        ValueError: if a number is out of range.
        KeyError: if wrench and twist, or the given power, are not observed.

    Source:
        Paper, section "Common Experimental Setup", ``P_t <= P_max`` on the wrist's force-torque reading.

    Examples:
        >>> PowerLimitTransform(p_max=2.0, penalty=10.0, terminate=True).p_max
        2.0
        >>> work = PowerLimitTransform(p_max=0.0, power_key="power")
    """

    _at_control_rate = True

    def __init__(
        self,
        p_max: float = 2.0,
        *,
        penalty: float = 0.0,
        terminate: bool = False,
        dt: float | None = None,
        wrench_key: NestedKey = "wrench",
        twist_key: NestedKey = "twist",
        power_key: NestedKey | None = None,
        cost_key: NestedKey = "cost",
    ) -> None:
        readings = [wrench_key, twist_key] if power_key is None else [power_key]
        super().__init__(in_keys=readings, out_keys=[cost_key])
        self.p_max = require_in_range("p_max", p_max, 0.0, unit="W")
        self.penalty = require_in_range("penalty", penalty, 0.0, unit="[1/J]")
        require_instance("terminate", terminate, bool)
        self.terminate = terminate
        self.dt = dt

    def _outputs(self, tensordict: TensorDictBase, state: Entries, *readings: Tensor) -> Entries:
        measured = readings[0] if len(readings) == 1 else power(*readings)
        excess = (measured.abs() - self.p_max).clamp_min(0.0)  # [W]
        return {self.out_keys[0]: self.dt * excess}

    def _output_specs(self, batch: torch.Size, like: TensorSpec) -> dict[NestedKey, TensorSpec]:
        return {self.out_keys[0]: real(like, *like.shape[:-1], 1)}

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        next_tensordict = super()._step(tensordict, next_tensordict)
        cost, stepping = next_tensordict.get(self.out_keys[0]), self._stepping(tensordict)
        if stepping is not None:
            cost = torch.where(stepping.unsqueeze(-1), cost, torch.zeros_like(cost))
            next_tensordict.set(self.out_keys[0], cost)
        if self.penalty:
            reward = "reward" if self.parent is None else self.parent.reward_key
            next_tensordict.set(reward, next_tensordict.get(reward) - self.penalty * cost)
        if self.terminate:
            for key in ("terminated", "done"):
                next_tensordict.set(key, next_tensordict.get(key) | (cost > 0))
        return next_tensordict

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        tensordict_reset = super()._reset(tensordict, tensordict_reset)
        return tensordict_reset.set(self.out_keys[0], torch.zeros_like(tensordict_reset.get(self.out_keys[0])))
