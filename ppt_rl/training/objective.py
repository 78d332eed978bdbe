"""The losses of PPO and their gradients, without anything that an update does not need."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tensordict.utils import NestedKey
from torch import Tensor, nn
from torch.nn.functional import smooth_l1_loss
from torchrl.modules import ProbabilisticActor

__all__ = [
    "Loss",
    "Objective",
    "PolicyLoss",
    "ValueLoss",
    "added",
    "gaussian_divergence",
    "standardised",
    "summed",
]

_HALF_LOG_TAU = 0.5 * math.log(2 * math.pi)


class Loss(Protocol):
    """A part of the objective, from which one network learns; no other part has a gradient for its parameters."""

    @property
    def network(self) -> TensorDictModuleBase:
        """The network that learns."""
        ...

    @property
    def in_keys(self) -> list[NestedKey]:
        """Entries that the loss reads."""
        ...

    def __call__(self, rows: TensorDictBase) -> dict[str, Tensor]:
        """Scalars by name, each the mean over some rows."""
        ...


@dataclass(frozen=True)
class ValueLoss:
    """The smooth L1 distance of a value network's prediction to its target.

    Attributes:
        name: of the loss.
        network: writes ``value_key``.
        value_key: its prediction.
        target_key: what it should predict.
    """

    name: str
    network: TensorDictModuleBase
    value_key: NestedKey = "state_value"
    target_key: NestedKey = "value_target"

    @property
    def in_keys(self) -> list[NestedKey]:
        """Entries that the loss reads."""
        return [*self.network.in_keys, self.target_key]

    def __call__(self, rows: TensorDictBase) -> dict[str, Tensor]:
        """The loss by its name.

        Args:
            rows: ``(n,)`` rows with ``in_keys``.

        Returns:
            A scalar, the mean over the rows.
        """
        found = self.network(rows.select(*self.network.in_keys)).get(self.value_key)
        return {self.name: smooth_l1_loss(found, rows.get(self.target_key))}


class PolicyLoss:
    r"""PPO's clipped objective for a Gaussian policy, and its entropy bonus.

    .. math::
        L = -\frac1n \sum_i \min\big(\rho_i A_i,\ \mathrm{clip}(\rho_i, 1 - \epsilon, 1 + \epsilon) A_i\big), \qquad
        \rho_i = \frac{\pi(a_i | s_i)}{\pi_{old}(a_i | s_i)}

    Args:
        network: policy; the deterministic part writes ``loc`` and ``scale``.
        clip: epsilon [-].
        entropy: weight of the entropy bonus; zero leaves it out.

    Source:
        Schulman et al., "Proximal policy optimization algorithms" (2017).
    """

    def __init__(self, network: ProbabilisticActor, *, clip: float, entropy: float) -> None:
        self.network, self.entropy = network, entropy
        self._bounds = math.log1p(-clip) if clip < 1 else -math.inf, math.log1p(clip)
        (self._action_key,), (self._log_prob_key,) = network.dist_sample_keys, network.log_prob_keys
        #: Entries that the loss reads; the advantage is taken as it is.
        self.in_keys: list[NestedKey] = [*network.det_part.in_keys, self._action_key, self._log_prob_key, "advantage"]

    def __call__(self, rows: TensorDictBase) -> dict[str, Tensor]:
        """``loss_objective`` and, with a weight, ``loss_entropy``.

        Args:
            rows: ``(n,)`` rows with ``in_keys``.

        Returns:
            Scalars, each the mean over the rows.
        """
        loc, scale = self.moments(rows)
        action, advantage = rows.get(self._action_key), rows.get("advantage").squeeze(-1)
        log_prob = -(0.5 * ((action - loc) / scale).square() + scale.log() + _HALF_LOG_TAU).sum(-1)
        log_ratio = log_prob - rows.get(self._log_prob_key)
        gain = torch.minimum(log_ratio.exp() * advantage, log_ratio.clamp(*self._bounds).exp() * advantage)
        losses = {"loss_objective": -gain.mean()}
        if self.entropy > 0:
            losses["loss_entropy"] = -self.entropy * (0.5 + _HALF_LOG_TAU + scale.log()).sum(-1).mean()
        return losses

    def moments(self, rows: TensorDictBase) -> tuple[Tensor, Tensor]:
        """Mean and standard deviation of the policy, ``(n, A)`` each.

        Args:
            rows: ``(n,)`` rows with the observations that the policy reads.

        Returns:
            Both.
        """
        network = self.network.det_part
        found = network(rows.select(*network.in_keys))
        return found.get("loc"), found.get("scale")


class Objective:
    """The losses of PPO: that of the policy and one for each value network.

    Together they are those of :class:`torchrl.objectives.ClipPPOLoss`, to rounding, without its figures for a log.
    Networks share no parameter, so each loss can be differentiated by itself.

    Args:
        actor: policy; the deterministic part writes ``loc`` and ``scale``.
        values: value networks and what they learn.
        clip: epsilon of the clipped objective [-].
        entropy: weight of the entropy bonus; zero leaves it out.
    """

    def __init__(self, actor: ProbabilisticActor, values: Sequence[ValueLoss], *, clip: float, entropy: float) -> None:
        self.policy = PolicyLoss(actor, clip=clip, entropy=entropy)
        #: The losses, that of the policy first.
        self.losses: list[Loss] = [self.policy, *values]
        self.parameters: list[nn.Parameter] = [each for loss in self.losses for each in loss.network.parameters()]
        #: Entries that the losses read.
        self.in_keys: list[NestedKey] = list(dict.fromkeys(key for loss in self.losses for key in loss.in_keys))

    def gradients(
        self, rows: TensorDictBase, share: float = 1.0, losses: Sequence[Loss] | None = None
    ) -> tuple[dict[str, Tensor], list[Tensor | None]]:
        """Losses and the gradients of their sum.

        Args:
            rows: ``(n,)`` rows with what the losses read; their advantages are taken as they are.
            share: of these rows in all rows of the step, a factor on both.
            losses: those that are wanted; None takes them all.

        Returns:
            Scalars by name, and a gradient for each of ``parameters``, None where it has no influence.
        """
        found = {name: value for loss in losses or self.losses for name, value in loss(rows).items()}
        if share != 1.0:
            found = {name: share * value for name, value in found.items()}
        learning = [each for each in self.parameters if each.requires_grad]
        total = torch.stack(list(found.values())).sum()
        of_total = iter(torch.autograd.grad(total, learning, allow_unused=True))
        gradients = [next(of_total) if each.requires_grad else None for each in self.parameters]
        return {name: value.detach() for name, value in found.items()}, gradients


def standardised(advantage: Tensor) -> Tensor:
    """Advantages with mean zero and standard deviation one; a single one stays as it is.

    Args:
        advantage: ``(n, 1)``.

    Returns:
        ``(n, 1)``.
    """
    if advantage.numel() <= 1:
        return advantage
    return (advantage - advantage.mean()) / advantage.std().clamp_min(torch.finfo(torch.float32).resolution)


def gaussian_divergence(old: tuple[Tensor, Tensor], new: tuple[Tensor, Tensor]) -> Tensor:
    r"""Kullback-Leibler divergence of Gaussians with independent components.

    .. math:: \sum_j \tfrac12 \Big(\frac{\sigma_j^2}{s_j^2} + \frac{(\mu_j - m_j)^2}{s_j^2} - 1
        - \ln \frac{\sigma_j^2}{s_j^2}\Big)

    Args:
        old: mean ``\mu`` and standard deviation ``\sigma``, ``(*B, A)`` each.
        new: mean ``m`` and standard deviation ``s``, likewise.

    Returns:
        ``(*B,)`` divergence from ``old`` to ``new`` [nat].
    """
    ratio = (old[1] / new[1]).square()
    return (0.5 * (ratio + ((old[0] - new[0]) / new[1]).square() - 1 - ratio.log())).sum(-1)


def summed(losses: Sequence[Mapping[str, Tensor]]) -> dict[str, Tensor]:
    """Sums by name.

    Args:
        losses: scalars by name.

    Returns:
        For each name the sum over those that have it.
    """
    total: dict[str, Tensor] = {}
    for part in losses:
        total |= {name: total[name] + value if name in total else value for name, value in part.items()}
    return total


def added(parts: Sequence[Tensor | None]) -> Tensor | None:
    """The sum of the parts of a gradient.

    Args:
        parts: of one parameter; None has no influence.

    Returns:
        Their sum; None where no part has an influence.
    """
    there = [part for part in parts if part is not None]
    return sum(there[1:], there[0]) if there else None
