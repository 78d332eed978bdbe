"""A reward that makes energy from the tank cost something."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey, unravel_key
from torchrl.data import TensorSpec

from ppt_rl.functional.argument_checks import require_in_range
from ppt_rl.functional.constants import constant
from ppt_rl.transforms.base import StatefulTransform

__all__ = ["EnergyPenaltyTransform"]


class EnergyPenaltyTransform(StatefulTransform):
    r"""Subtracts from the reward what the level of a tank lost in the step.

    .. math:: r'_t = r_t - w\,(E_t - E_{t+1})

    An empty tank ends what a policy can do in an episode, but that says little about the episodes in which the tank
    lasts. With the penalty, a policy learns from every episode to do the same with less energy. The terms of an episode
    add up to ``w`` times the energy that was spent in it. Append it after the tank and before a
    :class:`MacroStepTransform`.

    Args:
        weight: ``w``, reward subtracted per joule [1/J]; zero leaves the reward alone.
        energy_key: the level of the tank [J], ``(*B, 1)``.
        reward_key: the reward, ``(*B, 1)``.

    Raises:
        ValueError: if the weight is negative or not finite, or the transform stands after a macro step.
        KeyError: if the environment has no such level or no such reward.

    Examples:
        >>> from torchrl.envs import Compose, TransformedEnv
        >>> from torchrl.envs.custom import PendulumEnv
        >>> from ppt_rl.transforms import EnergyTankTransform
        >>> tank = EnergyTankTransform(p_max=1.0, dt=0.05, flow_key="thdot")
        >>> env = TransformedEnv(PendulumEnv(), Compose(tank, EnergyPenaltyTransform(0.5)))
        >>> env.rollout(3)["next", "reward"].shape
        torch.Size([3, 1])
    """

    _at_control_rate = True
    _hint = " Append an EnergyTankTransform before it, or say which energy_key= the tank writes."

    def __init__(
        self, weight: float = 0.5, *, energy_key: NestedKey = "tank_energy", reward_key: NestedKey = "reward"
    ) -> None:
        super().__init__(in_keys=[energy_key], out_keys=[])
        self.weight = require_in_range("weight", weight, 0.0, unit="[1/J]")
        self.energy_key = energy_key
        self.reward_key = reward_key

    @property
    def _readings(self) -> tuple[NestedKey, ...]:
        return (self.energy_key,)

    def _like(self) -> TensorSpec:
        return self.parent.full_observation_spec[self.energy_key]

    def _check_place(self) -> None:
        super()._check_place()
        for key, spec in ((self.energy_key, "full_observation_spec"), (self.reward_key, "full_reward_spec")):
            keys = list(getattr(self.parent, spec).keys(True, True))
            if unravel_key(key) not in keys:
                raise KeyError(f"{type(self).__name__} needs {key!r}; the environment has {keys}.{self._hint}")

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict

    def _after_step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        (before,) = self._recall(tensordict, self.energy_key)
        after, reward = self._require(next_tensordict, self.energy_key, self.reward_key)
        spent, stepping = before - after, self._stepping(tensordict)
        if stepping is not None:
            spent = torch.where(stepping.unsqueeze(-1), spent, torch.zeros_like(spent))
        return next_tensordict.set(self.reward_key, reward - constant(self.weight, spent) * spent)
