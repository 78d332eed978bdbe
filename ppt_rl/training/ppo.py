"""Proximal policy optimisation: its settings, and one update."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import ClipPPOLoss, KLAdaptiveLR
from torchrl.objectives.value import GAE

from ppt_rl.functional.checks import Bounds, require_bounds
from ppt_rl.training.finite import TrainingDiverged, first_not_finite, require_finite_update

__all__ = ["Learner", "PPOConfig"]

#: Losses that an update adds up, where the loss has them.
_LOSSES = ("loss_objective", "loss_critic", "loss_entropy", "loss_cost_critic")
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
        self.advantage = self._estimator(critic)
        self.loss = self._make_loss(
            clip_epsilon=config.clip, entropy_bonus=config.entropy > 0, entropy_coeff=config.entropy,
            critic_coeff=1.0, normalize_advantage=True, loss_critic_type="smooth_l1",
        )  # fmt: skip
        self.optimizer = torch.optim.Adam(self.loss.parameters(), lr=config.learning_rate, eps=1e-5)
        self.schedule = KLAdaptiveLR(self.optimizer, config.target_kl, max_lr=config.max_learning_rate)

    @property
    def networks(self) -> dict[str, nn.Module]:
        """What an update improves, by name."""
        return {"actor": self.actor, "critic": self.critic}

    @property
    def components(self) -> dict[str, Any]:
        """What a checkpoint holds of the learner, by name."""
        return {**self.networks, "optimizer": self.optimizer, "schedule": self.schedule}

    def _make_loss(self, **settings: Any) -> ClipPPOLoss:
        return ClipPPOLoss(self.actor, self.critic, **settings)

    def _estimator(self, critic: nn.Module, **keys: Any) -> GAE:
        """An estimator of advantages; it reads and writes the usual entries, but for those that are named."""
        config = self.config
        estimator = GAE(gamma=config.gamma, lmbda=config.gae_lambda, value_network=critic, average_gae=False)
        # A step-wise batch has no such entry: then every policy step is one control step.
        estimator.set_keys(steps_to_next_obs=("next", "control_steps"), **keys)
        return estimator

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
        config, steps = self.config, []
        for _ in range(config.epochs):
            for rows in torch.randperm(len(batch)).chunk(config.minibatches):
                steps.append(self._step(batch[rows]))
            self._require_finite_networks()
            divergence = self._divergence(batch)
            require_finite_update(divergence=divergence)
            self.schedule.step(divergence)
            if divergence > 2 * config.target_kl:
                break
        rate = self.optimizer.param_groups[0]["lr"]
        means = {name: float(torch.stack([step[name] for step in steps]).mean()) for name in steps[0]}
        return {**means, "kl": float(divergence), "learning_rate": rate}

    def _step(self, rows: TensorDictBase) -> Mapping[str, Tensor]:
        """One step of the optimizer; returns its losses."""
        losses = self.loss(rows)
        parts = {name: losses[name] for name in _LOSSES if name in losses.keys()}
        self.optimizer.zero_grad()
        sum(parts.values(), torch.zeros(())).backward()
        norms = [nn.utils.clip_grad_norm_(group, self.config.max_grad_norm) for group in self._clipped()]
        parts = {name: loss.detach() for name, loss in parts.items()}
        named = {name.removeprefix("loss_"): loss for name, loss in parts.items()}
        require_finite_update(**named, gradient=torch.stack(norms).sum())
        self.optimizer.step()
        return parts

    def _clipped(self) -> list[list[nn.Parameter]]:
        """Groups of parameters, of which each has a bound on the norm of its gradient."""
        return [list(self.loss.parameters())]

    def _require_finite_networks(self) -> None:
        broken = first_not_finite(self.networks)
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
