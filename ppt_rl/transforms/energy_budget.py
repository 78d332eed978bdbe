"""An action that also asks for the energy of its episode, and a reward that charges what was granted."""

from __future__ import annotations

import math

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey, unravel_key
from torch import Tensor
from torchrl.data import Composite, TensorSpec

from ppt_rl.functional.argument_checks import require_in_range, require_number
from ppt_rl.functional.checks import require_finite, require_positive
from ppt_rl.transforms.base import ActionTransform, merged
from ppt_rl.transforms.specs import real, replace_leaf

__all__ = ["EnergyBudgetTransform"]


class EnergyBudgetTransform(ActionTransform):
    r"""Takes the last entry ``u`` of an action as a request for energy, grants it within bounds, and charges it.

    .. math::
        E = E_{max} \bigg(m + (1 - m)\, \sigma\Big(u + \log\frac{s}{1 - s}\Big)\bigg), \qquad r' = r - w\,E

    Granted and charged is the request of the first policy step of an episode alone. The budget then stays as it is
    until the episode ends, whatever later actions ask for: a policy can neither buy energy later nor give it back. A
    tank keeps to it by ``EnergyTankTransform(e_max_key=limit_key)``, whose own ``e_max`` holds whatever is granted.

    The action outside has one entry more, ``(*B, A + 1)``, and no bounds. State and observation: ``energy_budget``
    ``(*B, 1)``, what was granted [J], zero before the first policy step. It is written to ``limit_key`` at every policy
    step. Append it after the tanks; behind a :class:`MacroStepTransform`, so that it acts once for each chunk.

    Args:
        e_max: most energy that is granted [J].
        least_share: m in (0, 1), the share of it that is granted whatever is asked for [-].
        initial_share: s in (0, 1), the share of the rest that a request of zero is granted [-].
        weight: w, reward subtracted per joule that is granted [1/J].
        limit_key: where the tanks read their capacity [J].
        action_key: the action: with a request outside, without one towards the environment.
        reward_key: the reward, of the shape of the budget.

    Raises:
        ValueError: if a number is out of range, an action is not finite or has no entry but the request, or the reward
            has another shape than the budget.
        KeyError: if no tank in the environment reads ``limit_key``, or there is no such action or reward.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> budget = EnergyBudgetTransform(1.3)
        >>> budget.inv(TensorDict(action=torch.ones(1, 4), batch_size=[1]))["action"].shape
        torch.Size([1, 3])
        >>> [round(float(value), 2) for value in budget.granted(torch.tensor([-9.0, 0.0, 9.0]))]
        [0.13, 1.07, 1.3]
    """

    _hint = " Append it after an EnergyTankTransform(e_max_key=limit_key), which holds that entry."

    def __init__(
        self,
        e_max: float,
        *,
        least_share: float = 0.1,
        initial_share: float = 0.8,
        weight: float = 1.0,
        limit_key: NestedKey = "e_max",
        action_key: NestedKey = "action",
        reward_key: NestedKey = "reward",
    ) -> None:
        super().__init__(action_key)
        self.e_max = require_positive("e_max", e_max, "J")
        self.least_share = _require_share("least_share", least_share)
        self.initial_share = _require_share("initial_share", initial_share)
        self.weight = require_in_range("weight", weight, 0.0, unit="[1/J]")
        self.limit_key, self.reward_key = limit_key, reward_key

    def granted(self, request: Tensor) -> Tensor:
        """The energy that a request is granted.

        Args:
            request: ``(*B, 1)`` any numbers [-].

        Returns:
            ``(*B, 1)`` from ``least_share * e_max`` to ``e_max`` [J].
        """
        share = torch.sigmoid(request + math.log(self.initial_share / (1.0 - self.initial_share)))
        return self.e_max * (self.least_share + (1.0 - self.least_share) * share)  # a sum of 1 is rounded to 1 at most

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        (action,) = self._require(tensordict, self.action_key)
        if action.ndim == 0 or action.shape[-1] < 2:
            raise ValueError(
                f"action (with a request) has shape {tuple(action.shape)}; expected (*B, A + 1), the action and one "
                "request for energy."
            )
        require_finite("action (with a request)", action)
        tensordict.set(self.action_key, action[..., :-1])
        if self.parent is not None:
            (before,) = self._recall(tensordict, "energy_budget")
            budget = torch.where(before > 0, before, self.granted(action[..., -1:]))
            self._stash(tensordict, "energy_budget", budget)
            rows = self._stepping(tensordict)
            limit = budget if rows is None else merged(rows, budget, tensordict.get(self.limit_key, None))
            tensordict.set(self.limit_key, limit)
        return tensordict

    def _check_place(self) -> None:
        super()._check_place()
        parent = self.parent
        for key, spec in ((self.limit_key, parent.full_observation_spec), (self.reward_key, parent.full_reward_spec)):
            keys = list(spec.keys(True, True))
            if unravel_key(key) not in keys:
                raise KeyError(f"{type(self).__name__} needs {key!r}; the environment has {keys}.{self._hint}")
        shape, reward = (*self._like().shape[:-1], 1), tuple(parent.full_reward_spec[self.reward_key].shape)
        if shape != reward:
            raise ValueError(
                f"the reward {self.reward_key!r} has shape {reward}, the budget {shape}; expected the same, so that "
                "each budget is charged once. Name the reward of the same nest."
            )

    # -- state --------------------------------------------------------------------------------------------------------

    def _after_step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        (before,) = self._recall(tensordict, "energy_budget")
        self._unstash(tensordict, next_tensordict, "energy_budget")
        # Where an environment does not step, or has its budget already, nothing changes and nothing is charged.
        (reward,) = self._require(next_tensordict, self.reward_key)
        charge = next_tensordict["energy_budget"] - before
        return next_tensordict.set(self.reward_key, reward - self.weight * charge)

    def _after_reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        zeros = self._zeros(self._state_specs(self.parent.batch_size, self._like()), tensordict_reset)
        self._restart(tensordict, tensordict_reset, "energy_budget", zeros["energy_budget"])
        return tensordict_reset

    def _state_specs(self, batch: torch.Size, like: TensorSpec) -> dict[NestedKey, TensorSpec]:
        return {"energy_budget": real(like, *like.shape[:-1], 1)}

    def transform_action_spec(self, action_spec: Composite) -> Composite:
        """Outside, the action has one entry more."""
        like = action_spec[self.action_key]
        spec = real(like, *like.shape[:-1], like.shape[-1] + 1)
        return replace_leaf(action_spec, self.action_key, spec, type(self).__name__)


def _require_share(name: str, value: float) -> float:
    """Return a share as a float; raise unless it lies between 0 and 1, both excluded."""
    share = require_number(name, value, "a number between 0 and 1, both excluded")
    if not 0.0 < share < 1.0:
        raise ValueError(f"{name} is {value}; expected a number between 0 and 1, both excluded.")
    return share
