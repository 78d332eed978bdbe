"""The losses of PPO and their gradients, without anything that an update does not need."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tensordict.utils import NestedKey
from torch import Tensor, nn
from torch.nn.functional import smooth_l1_loss
from torchrl.modules import ProbabilisticActor

__all__ = ["Objective", "ValueLoss", "gaussian_divergence", "standardised", "summed"]

_HALF_LOG_TAU = 0.5 * math.log(2 * math.pi)


@dataclass(frozen=True)
class ValueLoss:
    """A value network, and what it learns.

    Attributes:
        name: of its loss.
        network: writes ``value_key``.
        value_key: its prediction.
        target_key: what it should predict.
    """

    name: str
    network: TensorDictModuleBase
    value_key: NestedKey = "state_value"
    target_key: NestedKey = "value_target"


class Objective:
    r"""Losses of PPO with a clipped ratio for a Gaussian policy.

    .. math::
        L = -\frac1n \sum_i \min\big(\rho_i A_i,\ \mathrm{clip}(\rho_i, 1 - \epsilon, 1 + \epsilon) A_i\big), \qquad
        \rho_i = \frac{\pi(a_i | s_i)}{\pi_{old}(a_i | s_i)}

    and for every value network the smooth L1 distance to its target, and the entropy with its weight. These are the
    losses of :class:`torchrl.objectives.ClipPPOLoss`, to rounding, without its figures for a log.

    Args:
        actor: policy; the deterministic part writes ``loc`` and ``scale``.
        values: value networks and what they learn.
        clip: epsilon [-].
        entropy: weight of the entropy bonus; zero leaves it out.

    Source:
        Schulman et al., "Proximal policy optimization algorithms" (2017).
    """

    def __init__(self, actor: ProbabilisticActor, values: Sequence[ValueLoss], *, clip: float, entropy: float) -> None:
        self.actor, self.values, self.entropy = actor, list(values), entropy
        self._bounds = math.log1p(-clip) if clip < 1 else -math.inf, math.log1p(clip)
        (self._action_key,), (self._log_prob_key,) = actor.dist_sample_keys, actor.log_prob_keys
        networks = [actor, *(value.network for value in self.values)]
        self.parameters: list[nn.Parameter] = [each for network in networks for each in network.parameters()]
        keys = [key for network in [actor.det_part, *networks[1:]] for key in network.in_keys]
        keys += [self._action_key, self._log_prob_key, "advantage", *(value.target_key for value in self.values)]
        #: Entries that the losses read.
        self.in_keys: list[NestedKey] = list(dict.fromkeys(keys))

    def __call__(self, rows: TensorDictBase) -> dict[str, Tensor]:
        """Losses by name, each the mean over some rows.

        Args:
            rows: ``(n,)`` rows with ``in_keys``; their advantages are taken as they are.

        Returns:
            Scalars: ``loss_objective``, one of each value network and, with a weight, ``loss_entropy``.
        """
        loc, scale = self.moments(rows)
        action, advantage = rows.get(self._action_key), rows.get("advantage").squeeze(-1)
        log_prob = -(0.5 * ((action - loc) / scale).square() + scale.log() + _HALF_LOG_TAU).sum(-1)
        log_ratio = log_prob - rows.get(self._log_prob_key)
        gain = torch.minimum(log_ratio.exp() * advantage, log_ratio.clamp(*self._bounds).exp() * advantage)
        losses = {"loss_objective": -gain.mean()}
        for value in self.values:
            found = value.network(rows.select(*value.network.in_keys)).get(value.value_key)
            losses[value.name] = smooth_l1_loss(found, rows.get(value.target_key))
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
        network = self.actor.det_part
        found = network(rows.select(*network.in_keys))
        return found.get("loc"), found.get("scale")

    def gradients(self, rows: TensorDictBase, share: float = 1.0) -> tuple[dict[str, Tensor], list[Tensor | None]]:
        """Losses and the gradients of their sum.

        Args:
            rows: as for a call.
            share: of these rows in all rows of the step, a factor on both.

        Returns:
            Losses by name, and a gradient for each of ``parameters``, None where it has no influence.
        """
        losses = {name: loss if share == 1.0 else share * loss for name, loss in self(rows).items()}
        learning = [each for each in self.parameters if each.requires_grad]
        total = torch.stack(list(losses.values())).sum()
        found = iter(torch.autograd.grad(total, learning, allow_unused=True))
        gradients = [next(found) if each.requires_grad else None for each in self.parameters]
        return {name: loss.detach() for name, loss in losses.items()}, gradients


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
        losses: scalars by name, the same names in each.

    Returns:
        Scalars by name.
    """
    first, *others = losses
    return {name: sum((other[name] for other in others), loss) for name, loss in first.items()}
