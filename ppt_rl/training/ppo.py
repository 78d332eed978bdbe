"""Proximal policy optimisation: its settings, and one update."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import ClassVar

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import ClipPPOLoss, KLAdaptiveLR
from torchrl.objectives.value import GAE

from ppt_rl.functional.checks import Bounds, require_bounds
from ppt_rl.training.finite import TrainingDiverged, first_not_finite, require_finite_update

__all__ = ["Learner", "PPOConfig"]

#: Number of policy steps in a batch from which an update uses every CPU.
_LARGE = 4096


@dataclass(frozen=True)
class PPOConfig:
    """Settings of PPO.

    Attributes:
        total_control_steps: budget, summed over environments [control steps].
        epochs: number of passes over a batch.
        minibatches: number of minibatches in a pass.
        learning_rate: learning rate at the start; the KL divergence adapts it.
        max_learning_rate: upper bound of the adapted rate.
        target_kl: divergence per update that the adapted rate aims at [nat].
        clip: epsilon of the clipped objective.
        entropy: weight of the entropy bonus.
        gamma: discount per control step.
        gae_lambda: lambda of the generalised advantage estimate.
        max_grad_norm: bound on the gradient's norm.
        checkpoint_every: number of batches between checkpoints.
    """

    total_control_steps: int = 921_600
    epochs: int = 8
    minibatches: int = 4
    learning_rate: float = 3e-4
    max_learning_rate: float = 2e-3
    target_kl: float = 0.02
    clip: float = 0.2
    entropy: float = 0.0
    gamma: float = 1.0
    gae_lambda: float = 0.95
    max_grad_norm: float = 1.0
    checkpoint_every: int = 5

    bounds: ClassVar[dict[str, Bounds]] = {
        "total_control_steps": Bounds(0, 10**12, "control steps"),
        "epochs": Bounds(1, 1000),
        "minibatches": Bounds(1, 100_000),
        "learning_rate": Bounds(1e-12, 10.0),
        "max_learning_rate": Bounds(1e-12, 10.0),
        "target_kl": Bounds(1e-12, 1e9, "nat"),
        "clip": Bounds(1e-9, 10.0),
        "entropy": Bounds(0.0, 1e3),
        "gamma": Bounds(1e-9, 1.0),
        "gae_lambda": Bounds(1e-9, 1.0),
        "max_grad_norm": Bounds(1e-9, 1e9),
        "checkpoint_every": Bounds(1, 10**9, "batches"),
    }

    def __post_init__(self) -> None:
        """Refuse impossible settings."""
        require_bounds(self, self.bounds)


@contextmanager
def _threads(count: int) -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


class Learner:
    """Losses, optimizer and learning-rate schedule of one run.

    Args:
        actor: policy; its distribution is Gaussian with ``loc`` and ``scale`` in the batch.
        critic: value network.
        config: settings.
    """

    def __init__(self, actor: ProbabilisticActor, critic: nn.Module, config: PPOConfig) -> None:
        self.actor, self.critic, self.config = actor, critic, config
        self.advantage = GAE(gamma=config.gamma, lmbda=config.gae_lambda, value_network=critic, average_gae=False)
        # A step-wise batch has no such entry: then every policy step is one control step.
        self.advantage.set_keys(steps_to_next_obs=("next", "control_steps"))
        self.loss = ClipPPOLoss(
            actor, critic, clip_epsilon=config.clip, entropy_bonus=config.entropy > 0, entropy_coeff=config.entropy,
            critic_coeff=1.0, normalize_advantage=True, loss_critic_type="smooth_l1",
        )  # fmt: skip
        self.optimizer = torch.optim.Adam(self.loss.parameters(), lr=config.learning_rate, eps=1e-5)
        self.schedule = KLAdaptiveLR(self.optimizer, config.target_kl, max_lr=config.max_learning_rate)

    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """Improve actor and critic on one batch; stop early once the policy has moved far enough.

        Args:
            batch: what the collector returned.

        Returns:
            Mean losses, the divergence from the policy that acted [nat] and the learning rate.

        Raises:
            TrainingDiverged: before a step that is not finite.
        """
        with _threads(len(os.sched_getaffinity(0)) if batch.numel() > _LARGE else torch.get_num_threads()):
            return self._improve(self._with_advantage(batch))

    def _improve(self, batch: TensorDictBase) -> dict[str, float]:
        config, totals, updates = self.config, torch.zeros(2), 0
        for _ in range(config.epochs):
            for rows in torch.randperm(len(batch)).chunk(config.minibatches):
                losses = self.loss(batch[rows])
                total = losses["loss_objective"] + losses["loss_critic"] + losses.get("loss_entropy", torch.zeros(()))
                self.optimizer.zero_grad()
                total.backward()
                norm = nn.utils.clip_grad_norm_(self.loss.parameters(), config.max_grad_norm)
                require_finite_update(
                    objective=losses["loss_objective"].detach(), critic=losses["loss_critic"].detach(), gradient=norm
                )
                self.optimizer.step()
                totals += torch.stack([losses["loss_objective"].detach(), losses["loss_critic"].detach()])
                updates += 1
            self._require_finite_networks()
            divergence = self._divergence(batch)
            require_finite_update(divergence=divergence)
            self.schedule.step(divergence)
            if divergence > 2 * config.target_kl:
                break
        objective, critic = (totals / updates).tolist()
        rate = self.optimizer.param_groups[0]["lr"]
        return {
            "loss_objective": objective, "loss_critic": critic, "kl": float(divergence), "learning_rate": rate,
        }  # fmt: skip

    def _require_finite_networks(self) -> None:
        broken = first_not_finite({"actor": self.actor, "critic": self.critic})
        if broken is not None:
            raise TrainingDiverged(f"{broken} is not finite")

    @torch.no_grad()
    def _with_advantage(self, batch: TensorDictBase) -> TensorDictBase:
        """A flat batch of the entries that the loss reads; a step-wise batch is large, so the rest is dropped."""
        batch = self.advantage(batch)
        keys = {"loc", "scale", "advantage", "value_target", *self.loss.in_keys}
        return batch.select(*keys, strict=False).reshape(-1)

    @torch.no_grad()
    def _divergence(self, batch: TensorDictBase) -> Tensor:
        """Mean KL divergence from the policy that acted to the present one, exact for Gaussians.

        The loss's own ``kl_approx`` is a sample mean: with a hundred actions its noise is larger than the target.
        """
        old = torch.distributions.Normal(batch["loc"], batch["scale"])
        acting = self.actor.get_dist(batch.select(*self.actor.in_keys))
        return torch.distributions.kl_divergence(old, acting.base_dist).sum(-1).mean()
