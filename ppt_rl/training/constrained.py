"""PPO under a limit on the mean cost of an episode."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDictBase
from torch import nn
from torchrl.modules import ProbabilisticActor

from ppt_rl.functional.lagrangian import penalised
from ppt_rl.training.finite import require_finite_update
from ppt_rl.training.lagrangian import Constraint, EpisodeCosts, cost_of
from ppt_rl.training.objective import ValueLoss
from ppt_rl.training.ppo import Learner, PPOConfig

__all__ = ["ConstrainedLearner"]


class ConstrainedLearner(Learner):
    r"""PPO whose objective is the reward less the weighted cost; a PID controller moves the weight, the multiplier.

    Every update first moves the multiplier by the mean cost of the episodes that ended in the batch, then improves the
    policy on

    .. math:: \frac{r - \lambda c}{1 + \lambda}

    With a cost critic, reward and cost have a value network each, and their advantages are combined. Without one, the
    critic learns the value of the penalised reward, which changes with the multiplier.

    Args:
        actor: policy; its distribution is Gaussian with ``loc`` and ``scale`` in the batch.
        critic: value network.
        config: settings.
        constraint: limit, multiplier, value network of the cost and its key.
        threads: as for :class:`Learner`.
    """

    def __init__(
        self, actor: ProbabilisticActor, critic: nn.Module, config: PPOConfig, constraint: Constraint,
        threads: int | None = None,
    ) -> None:  # fmt: skip
        self.constraint = constraint
        super().__init__(actor, critic, config, threads)
        self.cost_advantage = None
        if constraint.cost_critic is not None:
            self.cost_advantage = self._estimator(
                constraint.cost_critic, reward=constraint.cost_key, advantage="cost_advantage",
                value_target="cost_value_target", value="cost_value",
            )  # fmt: skip
        self._episode_costs = EpisodeCosts()

    @property
    def networks(self) -> dict[str, nn.Module]:
        """What an update improves, by name."""
        cost_critic = self.constraint.cost_critic
        return super().networks | ({} if cost_critic is None else {"cost_critic": cost_critic})

    @property
    def components(self) -> dict[str, Any]:
        """What a checkpoint holds of the learner, by name."""
        return super().components | {"multiplier": self.constraint.multiplier}

    def _values(self) -> list[ValueLoss]:
        cost_critic = self.constraint.cost_critic
        own = (
            []
            if cost_critic is None
            else [ValueLoss("loss_cost_critic", cost_critic, "cost_value", "cost_value_target")]
        )
        return [*super()._values(), *own]

    def _clipped(self) -> list[list[nn.Parameter]]:
        """The cost critic has a bound of its own, so that at a multiplier of zero it changes nothing of the others."""
        cost_critic, everything = self.constraint.cost_critic, self.objective.parameters
        own = set() if cost_critic is None else set(cost_critic.parameters())
        groups = [[each for each in everything if (each in own) == apart] for apart in (False, True)]
        return [group for group in groups if group]

    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """Move the multiplier, then improve the networks on one batch.

        Args:
            batch: what the collector returned, with the cost of every step.

        Returns:
            What PPO returns, ``cost_limit``, ``multiplier`` and, where episodes ended, their mean ``cost``.

        Raises:
            KeyError: if the batch has no cost.
            TrainingDiverged: before a step that is not finite.
        """
        constraint = self.constraint
        costs = self._episode_costs(cost_of(batch, constraint.cost_key), batch["next", "done"])
        scalars = {}
        if len(costs):
            mean = costs.to(torch.float64).mean()
            require_finite_update(cost=mean)
            constraint.multiplier.update(mean)
            scalars["cost"] = float(mean)
        scalars |= {"cost_limit": constraint.multiplier.limit, "multiplier": float(constraint.multiplier())}
        return super().update(batch) | scalars

    @torch.no_grad()
    def _with_advantage(self, batch: TensorDictBase) -> TensorDictBase:
        constraint = self.constraint
        multiplier = constraint.multiplier()
        if self.cost_advantage is not None:
            batch = self.cost_advantage(batch.copy().set("next", batch["next"].copy()))
            cost_advantage = batch["cost_advantage"].reshape(-1, 1)
            flat = super()._with_advantage(batch)
            return flat.set("advantage", penalised(flat["advantage"], cost_advantage, multiplier))
        following = batch["next"].copy()
        following["reward"] = penalised(following["reward"], cost_of(batch, constraint.cost_key), multiplier)
        return super()._with_advantage(batch.copy().set("next", following))
