"""PPO under a limit on the mean cost of an episode: the loss, and the costs of episodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase, TensorDictParams
from tensordict.nn import TensorDictModule, dispatch
from tensordict.utils import NestedKey
from torch import Tensor, nn
from torchrl.envs import EnvBase
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.utils import distance_loss

from ppt_rl.functional.lagrangian import penalised
from ppt_rl.modules.lagrangian import PIDMultiplier

__all__ = ["Constraint", "EpisodeCosts", "LagrangianPPOLoss", "cost_of", "require_cost"]


@dataclass(frozen=True)
class Constraint:
    """A limit on the mean cost of an episode.

    Attributes:
        multiplier: its multiplier.
        cost_critic: value network of the cost, which writes ``cost_value``; None leaves one critic, that of the
            penalised reward.
        cost_key: the cost of a step, under ``next``.
    """

    multiplier: PIDMultiplier
    cost_critic: nn.Module | None = None
    cost_key: NestedKey = "cost"


class LagrangianPPOLoss(ClipPPOLoss):
    r"""Clipped PPO on the penalised advantage, and the loss of a value network of the cost.

    .. math:: A = \frac{A_r - \lambda A_c}{1 + \lambda}

    At a multiplier of zero, ``loss_objective``, ``loss_critic`` and their gradients are those of
    :class:`torchrl.objectives.ClipPPOLoss`. The multiplier itself gets no gradient: update it once a batch.

    The batch needs ``cost_advantage`` and ``cost_value_target`` besides what PPO needs. A second ``GAE`` writes them
    after ``set_keys(reward="cost", advantage="cost_advantage", value_target="cost_value_target", value="cost_value")``.

    Args:
        actor_network: policy.
        critic_network: value network of the reward.
        cost_critic_network: value network of the cost; it writes ``cost_value``.
        multiplier: the multiplier.
        **kwargs: further arguments of :class:`torchrl.objectives.ClipPPOLoss`.

    Source:
        Stooke, Achiam and Abbeel, "Responsive Safety in Reinforcement Learning by PID Lagrangian Methods" (2020),
        equation 12.
    """

    @dataclass
    class _AcceptedKeys(ClipPPOLoss._AcceptedKeys):
        cost_advantage: NestedKey = "cost_advantage"
        cost_value_target: NestedKey = "cost_value_target"
        cost_value: NestedKey = "cost_value"

    default_keys = _AcceptedKeys
    tensor_keys: _AcceptedKeys
    cost_critic_network: TensorDictModule
    cost_critic_network_params: TensorDictParams
    target_cost_critic_network_params: TensorDictParams

    def __init__(
        self,
        actor_network: ProbabilisticActor,
        critic_network: nn.Module,
        cost_critic_network: nn.Module,
        multiplier: PIDMultiplier,
        **kwargs: Any,
    ) -> None:
        super().__init__(actor_network, critic_network, **kwargs)
        self.convert_to_functional(cost_critic_network, "cost_critic_network")
        self.multiplier = multiplier
        self._set_in_keys()
        self._out_keys = [*self.out_keys, "loss_cost_critic"]

    def _set_in_keys(self) -> None:
        super()._set_in_keys()
        if "cost_critic_network_params" not in self._modules:  # called by the constructor of PPO's loss
            return
        keys = self.tensor_keys
        more = [keys.cost_advantage, keys.cost_value_target, *self.cost_critic_network.in_keys]
        self._in_keys: list[NestedKey] = list(dict.fromkeys([*self._in_keys, *more]))

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The losses of a batch.

        Args:
            tensordict: the batch, with the advantages of reward and cost.

        Returns:
            What PPO returns, and ``loss_cost_critic``.

        Raises:
            KeyError: if an advantage is missing.
        """
        keys = self.tensor_keys
        needed = (keys.advantage, keys.cost_advantage, keys.cost_value_target)
        missing = [key for key in needed if tensordict.get(key, None) is None]
        if missing:
            raise KeyError(
                f"the batch lacks {missing}; expected the advantages of reward and cost. Apply a GAE to each of both."
            )
        batch = tensordict.clone(False)
        advantage = penalised(batch[keys.advantage], batch[keys.cost_advantage], self.multiplier())
        losses = super().forward(batch.set(keys.advantage, advantage))
        return losses.set("loss_cost_critic", self._loss_cost_critic(batch))

    def _loss_cost_critic(self, batch: TensorDictBase) -> Tensor:
        keys, network = self.tensor_keys, self.cost_critic_network
        with self.cost_critic_network_params.to_module(network):
            value = network(batch.select(*network.in_keys))[keys.cost_value]
        return distance_loss(batch[keys.cost_value_target], value, loss_function=self.loss_critic_type).mean()


class EpisodeCosts:
    """Sums the costs of every episode, over batches that end within an episode too.

    What it holds are the open episodes of the environments. It is not part of a checkpoint, since a run that goes on
    begins new episodes.
    """

    def __init__(self) -> None:
        self._open: Tensor | None = None

    def __call__(self, cost: Tensor, done: Tensor) -> Tensor:
        """The costs of the episodes that end in a batch.

        Args:
            cost: ``(*B, T, 1)`` cost of every step.
            done: ``(*B, T, 1)`` whether the episode ends with it.

        Returns:
            ``(n,)`` costs of the n episodes that end.
        """
        steps, ends = cost.flatten(0, -3) if cost.ndim > 2 else cost.unsqueeze(0), done.reshape(-1, *done.shape[-2:])
        total = torch.zeros_like(steps[:, 0]) if self._open is None else self._open
        ended = []
        for step, end in zip(steps.unbind(1), ends.unbind(1), strict=True):
            total = total + step
            ended.append(total[end])
            total = total.masked_fill(end, 0.0)
        self._open = total
        return torch.cat(ended)


def cost_of(batch: TensorDictBase, cost_key: NestedKey) -> Tensor:
    """The cost of every step of a batch.

    Args:
        batch: what the collector returned.
        cost_key: the cost, under ``next``.

    Returns:
        ``(*B, T, 1)``.

    Raises:
        KeyError: if there is none.
        ValueError: if it has another shape.
    """
    following = batch.get("next", TensorDict())
    cost = following.get(cost_key, None)
    if cost is None:
        raise KeyError(_missing(cost_key, list(following.keys(True, True))))
    if cost.shape != (*batch.shape, 1):
        raise ValueError(
            f"{cost_key!r} has shape {tuple(cost.shape)}; expected {(*batch.shape, 1)}, one number a step."
        )
    return cost


def require_cost(env: EnvBase, cost_key: NestedKey) -> None:
    """Raise unless an environment declares a cost.

    Args:
        env: environment with the recipe's chain.
        cost_key: the cost.

    Raises:
        KeyError: if neither its observations nor its rewards hold one.
    """
    known = [*env.full_observation_spec.keys(True, True), *env.full_reward_spec.keys(True, True)]
    if cost_key not in known:
        raise KeyError(_missing(cost_key, known))


def _missing(cost_key: NestedKey, known: list[NestedKey]) -> str:
    return (
        f"a step has no cost {cost_key!r}, only {known}; expected one number a step, whose sum over an episode is "
        "limited. Append a transform that writes it, such as PowerLimitTransform before a macro step, or name another "
        "entry with cost_key."
    )
