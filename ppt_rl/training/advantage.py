"""Advantages of a batch, with one evaluation of the value network for each state."""

from __future__ import annotations

from functools import partial
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.objectives.value import GAE

from ppt_rl.training.shards import Shards

__all__ = ["AdvantageEstimator"]


class AdvantageEstimator:
    r"""Generalised advantage estimation over what a collector returned.

    .. math::
        \delta_t &= r_t + \gamma^{n_t} V(s_{t+1}) (1 - \mathrm{terminated}_t) - V(s_t) \\
        A_t &= \delta_t + \gamma^{n_t} \lambda\,(1 - \mathrm{done}_t)\,A_{t+1}

    where ``n_t`` is the number of control steps in a policy step, the entry ``("next", "control_steps")``; without it
    every policy step is one control step. Between two steps of an episode ``s_{t+1}`` is the next root, whose value is
    known. Only the states that an episode or the batch is cut off at are evaluated for themselves, and no state beyond
    the end of a task.

    Args:
        critic: value network.
        gamma: discount per control step [-].
        gae_lambda: lambda [-].
        shards: spreads the evaluation of many states over the CPUs; None keeps it in this thread.
        **keys: where reward and value are read, and advantage and value target written, as for
            :meth:`torchrl.objectives.value.GAE.set_keys`.

    Source:
        Schulman et al., "High-dimensional continuous control using generalized advantage estimation" (2016).
    """

    def __init__(
        self,
        critic: TensorDictModuleBase,
        gamma: float,
        gae_lambda: float,
        *,
        shards: Shards | None = None,
        **keys: Any,
    ) -> None:
        self.critic, self._shards = critic, shards or Shards(1)
        self._gae = GAE(gamma=gamma, lmbda=gae_lambda, value_network=None, average_gae=False, vectorized=False)
        self._gae.set_keys(steps_to_next_obs=("next", "control_steps"), **keys)

    @torch.no_grad()
    def __call__(self, batch: TensorDictBase) -> TensorDictBase:
        """Write values, advantages and value targets into a batch.

        Args:
            batch: ``(*B, T)`` with the steps of an episode one after the other, changed in place.

        Returns:
            The batch.
        """
        key = self._gae.tensor_keys.value
        following = batch["next"]
        value = self._value(batch.select(*self.critic.in_keys).reshape(-1)).reshape(*batch.shape, 1)
        after = torch.cat([value[..., 1:, :], torch.zeros_like(value[..., :1, :])], -2)
        cut = following["done"].clone()
        cut[..., -1, :] = True
        rows = (cut & ~following.get("terminated", following["done"])).flatten().nonzero().squeeze(-1)
        if len(rows):
            states = following.select(*self.critic.in_keys).reshape(-1)[rows]
            after.view(-1, 1)[rows] = self._value(states)
        batch.set(key, value)
        batch.set(("next", key), after)
        return self._gae(batch, time_dim=batch.ndim - 1)

    def _value(self, states: TensorDictBase) -> Tensor:
        """``(n, 1)`` values of ``(n,)`` states."""

        def value(part: TensorDictBase) -> Tensor:
            with torch.no_grad():  # each thread has a mode of its own
                return self.critic(part)[self._gae.tensor_keys.value]

        count = self._shards.count(len(states), next(iter(states.values(True, True))).device)
        return torch.cat(self._shards.run([partial(value, part) for part in states.chunk(count)]))
