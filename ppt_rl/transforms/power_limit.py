"""The safety constraint on measured power: a penalty, a cost, and the end of an episode."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from ppt_rl.functional.checks import require_positive
from ppt_rl.functional.impedance import power
from ppt_rl.transforms.timed import TimedTransform

__all__ = ["PowerLimitTransform"]


class PowerLimitTransform(TimedTransform, Transform):
    r"""Watches the power of the MEASURED wrench, ``P = wrench . twist``, and what it exceeds its limit by.

    .. math:: c = \Delta t\,\max(0, |P| - P_{max}), \qquad r' = r - \mathrm{penalty} \cdot c

    It writes the cost ``c`` ``(*B, 1)`` [J] under ``("next", "cost")``, where constrained-RL losses look for it. With
    ``terminate`` an episode ends (``terminated``) at the first step above the limit. Unlike the
    :class:`EnergyTankTransform` it does not act on the action: it makes the constraint a part of the task.

    Append it before a :class:`MacroStepTransform`, which sums ``cost`` (under that key) over its control steps like
    rewards. Where it terminates, append it before an :class:`EpisodeMetricsTransform` too, which has to see where
    episodes end. The penalty changes the reward only, not what stands under ``reward_terms``.

    Args:
        p_max: limit of the measured power [W].
        penalty: reward taken off per joule above the limit [1/J]; zero leaves the reward alone.
        terminate: whether a step above the limit ends the episode.
        dt: control step [s]; None takes it from the environment, and needs one.
        wrench_key: measured wrench on the world.
        twist_key: measured twist.
        reward_key: the reward that the penalty is taken off.
        cost_key: where the cost is written.

    Raises:
        ValueError: if a number is out of range.
        KeyError: if wrench or twist are not observed.

    Source:
        Paper, section "Common Experimental Setup", ``P_t <= P_max`` on the wrist's force-torque reading.

    Examples:
        >>> PowerLimitTransform(p_max=2.0, penalty=10.0, terminate=True).p_max
        2.0
    """

    def __init__(
        self,
        p_max: float = 2.0,
        *,
        penalty: float = 0.0,
        terminate: bool = False,
        dt: float | None = None,
        wrench_key: NestedKey = "wrench",
        twist_key: NestedKey = "twist",
        reward_key: NestedKey = "reward",
        cost_key: NestedKey = "cost",
    ) -> None:
        super().__init__(in_keys=[wrench_key, twist_key], out_keys=[cost_key])
        self.p_max = require_positive("p_max", p_max, "W")
        self.dt = dt
        self.penalty = float(penalty)
        if not 0.0 <= self.penalty < float("inf"):
            raise ValueError(f"penalty is {penalty}; expected a finite number of at least 0 [1/J].")
        self.terminate = terminate
        self.reward_key = reward_key

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        cost = self._cost(next_tensordict)
        step = tensordict.get("_step", None)
        if step is not None:
            cost = torch.where(step.reshape(tensordict.batch_size).unsqueeze(-1), cost, torch.zeros_like(cost))
        next_tensordict.set(self.out_keys[0], cost)
        if self.penalty:
            next_tensordict.set(self.reward_key, next_tensordict.get(self.reward_key) - self.penalty * cost)
        if self.terminate:
            for key in ("terminated", "done"):
                next_tensordict.set(key, next_tensordict.get(key) | (cost > 0))
        return next_tensordict

    def _cost(self, tensordict: TensorDictBase) -> torch.Tensor:
        wrench, twist = (tensordict.get(key, None) for key in self.in_keys)
        if wrench is None or twist is None:
            raise KeyError(
                f"PowerLimitTransform needs {self.in_keys}; the tensordict holds "
                f"{sorted(str(key) for key in tensordict.keys(True, True))}."
            )
        return self.dt * (power(wrench, twist).abs() - self.p_max).clamp_min(0.0)

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return tensordict_reset.set(self.out_keys[0], torch.zeros_like(self._cost(tensordict_reset)))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the cost of stored readings; rewards and ends are those of the record."""
        return tensordict.set(self.out_keys[0], self._cost(tensordict))

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Declare the cost."""
        like = observation_spec[self.in_keys[0]]
        shape = (*like.shape[:-1], 1)
        observation_spec[self.out_keys[0]] = Unbounded(shape=shape, dtype=like.dtype, device=like.device)
        return observation_spec
