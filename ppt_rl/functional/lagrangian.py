"""The multiplier of a limited cost, moved by a PID controller, and the advantage that it penalises."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from ppt_rl.functional.checks import Bounds, require_bounds, require_finite

__all__ = ["MultiplierState", "PIDGains", "begin_multiplier", "penalised", "pid_multiplier"]


@dataclass(frozen=True)
class PIDGains:
    """Gains of the controller that moves a multiplier; the multiplier is in units of reward per unit of cost.

    Attributes:
        proportional: multiplier per unit of cost above the limit.
        integral: the same, added in every update and kept.
        derivative: multiplier per unit by which the cost has risen since the last update.
        smoothing: share of the last smoothed cost that remains in the next one, for the first and the third term [-].
        max_multiplier: largest multiplier, and largest value of the integral.
    """

    proportional: float = 1.0
    integral: float = 0.1
    derivative: float = 0.0
    smoothing: float = 0.0
    max_multiplier: float = 100.0

    bounds: ClassVar[dict[str, Bounds]] = {
        "proportional": Bounds(0.0, 1e9),
        "integral": Bounds(0.0, 1e9),
        "derivative": Bounds(0.0, 1e9),
        "smoothing": Bounds(0.0, 0.999),
        "max_multiplier": Bounds(1e-9, 1e9),
    }

    def __post_init__(self) -> None:
        """Refuse impossible gains."""
        require_bounds(self, self.bounds)


class MultiplierState(NamedTuple):
    """A multiplier and what its controller remembers, of one shape.

    Attributes:
        multiplier: the multiplier.
        integral: its integral term.
        cost: the smoothed cost; infinite before the first update.
    """

    multiplier: Tensor
    integral: Tensor
    cost: Tensor


def begin_multiplier(initial: Tensor) -> MultiplierState:
    """The state before the first update.

    Args:
        initial: multiplier to start from, any shape; the integral starts from it too.

    Returns:
        The state.
    """
    return MultiplierState(initial, initial, torch.full_like(initial, torch.inf))


def pid_multiplier(state: MultiplierState, cost: Tensor, limit: float, gains: PIDGains) -> MultiplierState:
    r"""Move a multiplier by one update of a PID controller on the cost.

    .. math::
        I_k &= \mathrm{clip}(I_{k-1} + K_I (J_k - d),\; 0,\; \lambda_{max}) \\
        S_k &= s\,S_{k-1} + (1 - s)\,J_k, \qquad S_1 = J_1 \\
        \lambda_k &= \mathrm{clip}\big(K_P (S_k - d) + I_k + K_D \max(0, S_k - S_{k-1}),\; 0,\; \lambda_{max}\big)

    The integral stays within the range of the multiplier, so that it does not wind up while the cost is out of reach of
    its limit. A falling cost is not held up: the derivative counts only where the cost rises, and is zero in the first
    update.

    Args:
        state: what :func:`begin_multiplier` or the last update returned.
        cost: J, mean cost of an episode, of the shape of the state.
        limit: d, limit of that mean.
        gains: gains, smoothing s and largest multiplier.

    Returns:
        The new state.

    Raises:
        ValueError: if the cost is not finite.

    Source:
        Stooke, Achiam and Abbeel, "Responsive Safety in Reinforcement Learning by PID Lagrangian Methods" (2020),
        algorithm 2. The paper's integral is divided by its gain and has no upper bound.
    """
    require_finite("cost", cost)
    high = gains.max_multiplier
    integral = (state.integral + gains.integral * (cost - limit)).clamp(0.0, high)
    last = torch.where(torch.isinf(state.cost), cost, state.cost)
    smoothed = gains.smoothing * last + (1.0 - gains.smoothing) * cost
    rise = (smoothed - last).clamp_min(0.0)
    multiplier = gains.proportional * (smoothed - limit) + integral + gains.derivative * rise
    return MultiplierState(multiplier.clamp(0.0, high), integral, smoothed)


def penalised(value: Tensor, cost: Tensor, multiplier: Tensor) -> Tensor:
    r"""Reward, or advantage, less the weighted cost, rescaled so that a large multiplier does not make steps larger.

    .. math:: \frac{r - \lambda c}{1 + \lambda}

    Args:
        value: r, rewards or advantages of the reward, ``(*B, 1)``.
        cost: c, costs or advantages of the cost, of the same shape.
        multiplier: lambda, a scalar that is not negative.

    Returns:
        ``(*B, 1)``; at a multiplier of zero, ``value`` itself.

    Source:
        As for :func:`pid_multiplier`, equation 12 and the rescaling that follows it.
    """
    multiplier = multiplier.to(value)
    return (value - multiplier * cost) / (1.0 + multiplier)
