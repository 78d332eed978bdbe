"""Proximal policy optimisation: its settings, and one update."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import KLAdaptiveLR

from ppt_rl.functional.checks import Bounds, is_readable, require_bounds
from ppt_rl.training.advantage import AdvantageEstimator
from ppt_rl.training.finite import TrainingDiverged, first_not_finite, require_finite_update
from ppt_rl.training.objective import Loss, Objective, ValueLoss, added, gaussian_divergence, standardised, summed
from ppt_rl.training.shards import Shards

__all__ = ["Learner", "PPOConfig"]

#: Most rows of which the divergence after a pass is computed.
_JUDGED = 1024
#: Losses by name, and the gradients of their sum.
Gradients = tuple[dict[str, Tensor], list[Tensor | None]]


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


class Learner:
    """Losses, optimizer and learning-rate schedule of one run.

    An update of a batch on a GPU copies nothing to the host but the divergence and the losses of each pass.

    Args:
        actor: policy; its distribution is Gaussian with ``loc`` and ``scale`` in the batch.
        critic: value network.
        config: settings.
        threads: threads of an update on the CPU; None takes one for each CPU. Few rows take fewer.
    """

    def __init__(
        self, actor: ProbabilisticActor, critic: nn.Module, config: PPOConfig, threads: int | None = None
    ) -> None:
        self.actor, self.critic, self.config = actor, critic, config
        self._shards = Shards(threads)
        self.advantage = self._estimator(critic)
        self.objective = Objective(actor, self._values(), clip=config.clip, entropy=config.entropy)
        self.optimizer = torch.optim.Adam(self.objective.parameters, lr=config.learning_rate, eps=1e-5, fused=True)
        self.schedule = KLAdaptiveLR(self.optimizer, config.target_kl, max_lr=config.max_learning_rate)

    @property
    def networks(self) -> dict[str, nn.Module]:
        """What an update improves, by name."""
        return {"actor": self.actor, "critic": self.critic}

    @property
    def components(self) -> dict[str, Any]:
        """What a checkpoint holds of the learner, by name."""
        return {**self.networks, "optimizer": self.optimizer, "schedule": self.schedule}

    def _values(self) -> list[ValueLoss]:
        return [ValueLoss("loss_critic", self.critic)]

    def _estimator(self, critic: nn.Module, **keys: Any) -> AdvantageEstimator:
        """An estimator of advantages; it reads and writes the usual entries, but for those that are named."""
        return AdvantageEstimator(critic, self.config.gamma, self.config.gae_lambda, shards=self._shards, **keys)

    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """Improve actor and critic on one batch; stop early once the policy has moved far enough.

        Args:
            batch: what the collector returned; it stays as it was.

        Returns:
            Mean losses, the divergence from the policy that acted [nat] and the learning rate.

        Raises:
            TrainingDiverged: before a step that is not finite.
        """
        with self._shards.alone():
            return self._improve(self._with_advantage(batch))

    def _improve(self, batch: TensorDictBase) -> dict[str, float]:
        config, steps, judged = self.config, [], self._judged(batch)
        read = batch.select(*self.objective.in_keys)
        for _ in range(config.epochs):
            minibatches = torch.randperm(len(batch)).to(batch["advantage"].device).chunk(config.minibatches)
            scaled = read.copy().set("advantage", _standardised_in(batch["advantage"], minibatches))
            steps += [self._step(scaled, rows) for rows in minibatches]
            self._require_finite_steps(steps[-len(minibatches) :])
            self._require_finite_networks()
            divergence = self._divergence(judged)
            require_finite_update(divergence=divergence)
            self.schedule.step(divergence)
            if divergence > 2 * config.target_kl:
                break
        rate = self.optimizer.param_groups[0]["lr"]
        means = {name: float(torch.stack([step[name] for step in steps]).mean()) for name in steps[0]}
        del means["gradient"]
        return {**means, "kl": float(divergence), "learning_rate": rate}

    def _step(self, batch: TensorDictBase, rows: Tensor) -> dict[str, Tensor]:
        """One step of the optimizer; returns its losses and the norm of its gradient."""
        found = self._shards.run(self._tasks(batch, rows))
        losses = summed([losses for losses, _ in found])
        for parameter, *parts in zip(self.objective.parameters, *(each for _, each in found), strict=True):
            parameter.grad = added(parts)
        norms = [nn.utils.clip_grad_norm_(group, self.config.max_grad_norm) for group in self._clipped()]
        losses["gradient"] = torch.stack(norms).sum()
        if is_readable(losses["gradient"]):
            self._require_finite_steps([losses])
        else:  # left out on the device; the host is told after the pass
            vars(self.optimizer)["found_inf"] = 1.0 - torch.stack(list(losses.values())).sum().isfinite().float()
        self.optimizer.step()
        return losses

    def _tasks(self, batch: TensorDictBase, rows: Tensor) -> list[Callable[[], Gradients]]:
        """The tasks of a step: a single one for few rows, else one for each loss and each part of the rows.

        Two losses keep two threads busy with whole minibatches, which is faster than all losses on halves of them.
        """
        losses, count = self.objective.losses, self._shards.count(len(rows), rows.device)
        if count == 1:  # a few rows, or a GPU, which does one thing after the other
            return [lambda: self.objective.gradients(batch[rows])]

        def task(loss: Loss, part: Tensor) -> Gradients:
            return self.objective.gradients(batch.select(*loss.in_keys)[part], len(part) / len(rows), [loss])

        parts = rows.tensor_split(count // math.gcd(count, len(losses)))
        return [partial(task, loss, part) for loss in losses for part in parts]

    def _clipped(self) -> list[list[nn.Parameter]]:
        """Groups of parameters, of which each has a bound on the norm of its gradient."""
        return [self.objective.parameters]

    def _require_finite_networks(self) -> None:
        if torch.stack([each.detach().sum() for each in self.objective.parameters]).sum().isfinite():
            return
        broken = first_not_finite(self.networks)
        if broken is not None:
            raise TrainingDiverged(f"{broken} is not finite")

    @staticmethod
    def _require_finite_steps(steps: Sequence[Mapping[str, Tensor]]) -> None:
        for step in torch.stack([torch.stack(list(step.values())) for step in steps]).cpu():
            require_finite_update(**{n.removeprefix("loss_"): v for n, v in zip(steps[0], step, strict=True)})

    @torch.no_grad()
    def _with_advantage(self, batch: TensorDictBase) -> TensorDictBase:
        """A flat batch of the entries that the losses read; a step-wise batch is large, so the rest is dropped."""
        batch = self.advantage(batch.copy().set("next", batch["next"].copy()))
        return batch.select("loc", "scale", *self.objective.in_keys, strict=False).reshape(-1)

    def _judged(self, batch: TensorDictBase) -> TensorDictBase:
        """The rows that stand for a batch in the divergence after each pass, taken at equal distances.

        The mean divergence over so many rows is known to a few percent. To evaluate the policy on all rows after each
        pass would take a sixth of the update.
        """
        keys = ("loc", "scale", *self.objective.policy.network.det_part.in_keys)
        return batch.select(*keys)[:: math.ceil(len(batch) / _JUDGED)].contiguous()

    @torch.no_grad()
    def _divergence(self, judged: TensorDictBase) -> Tensor:
        """Mean KL divergence from the policy that acted to the present one, exact for Gaussians.

        A sample mean of a hundred actions has a noise that is larger than the target.
        """

        def divergence(part: TensorDictBase) -> Tensor:
            with torch.no_grad():  # each thread has a mode of its own
                new = self.objective.policy.moments(part)
                return gaussian_divergence((part["loc"], part["scale"]), new).sum()

        parts = judged.split(_JUDGED // 2) if is_readable(judged["loc"]) else [judged]
        return torch.stack(self._shards.run([partial(divergence, part) for part in parts])).sum() / len(judged)


def _standardised_in(advantage: Tensor, minibatches: Sequence[Tensor]) -> Tensor:
    """Advantages ``(n, 1)`` that are standardised in each minibatch."""
    scaled = torch.empty_like(advantage)
    for rows in minibatches:
        scaled[rows] = standardised(advantage[rows])
    return scaled
