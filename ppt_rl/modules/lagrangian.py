"""A Lagrange multiplier with the state of the controller that moves it."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ppt_rl.functional.argument_checks import require_in_range, require_instance
from ppt_rl.functional.lagrangian import MultiplierState, PIDGains, begin_multiplier, pid_multiplier

__all__ = ["PIDMultiplier"]


class PIDMultiplier(nn.Module):
    """The multiplier of a limit on the mean cost of an episode, moved by a PID controller.

    It is a buffer, and so is what the controller remembers: a ``state_dict`` holds all of it, and no optimizer moves
    it. The law is :func:`~ppt_rl.functional.lagrangian.pid_multiplier`.

    Args:
        limit: limit of the mean cost of an episode, in the unit of the cost.
        gains: gains of the controller; None takes the defaults. All of them zero keep the multiplier where it is.
        initial: multiplier to start from [reward / cost].

    Raises:
        ValueError: if a number is out of range.

    Examples:
        >>> multiplier = PIDMultiplier(1.0, PIDGains(proportional=0.5, integral=0.1))
        >>> round(float(multiplier.update(torch.tensor(3.0))), 3)
        1.2
    """

    multiplier: Tensor
    integral: Tensor
    cost: Tensor

    def __init__(self, limit: float, gains: PIDGains | None = None, *, initial: float = 0.0) -> None:
        super().__init__()
        self.gains = PIDGains() if gains is None else gains
        require_instance("gains", self.gains, PIDGains)
        self.limit = require_in_range("limit", limit, 0.0)
        initial = require_in_range("initial", initial, 0.0, self.gains.max_multiplier)
        state = begin_multiplier(torch.tensor(initial, dtype=torch.float64))
        for name, value in state._asdict().items():
            self.register_buffer(name, value.clone())

    @torch.no_grad()
    def update(self, cost: Tensor) -> Tensor:
        """Move the multiplier.

        Args:
            cost: mean cost of the last episodes, a scalar.

        Returns:
            The new multiplier, a scalar.

        Raises:
            ValueError: if the cost is not finite.
        """
        old = MultiplierState(self.multiplier, self.integral, self.cost)
        new = pid_multiplier(old, cost.to(self.multiplier), self.limit, self.gains)
        for name, value in new._asdict().items():
            getattr(self, name).copy_(value)
        return self.multiplier

    def forward(self) -> Tensor:
        """The multiplier, a scalar."""
        return self.multiplier

    def extra_repr(self) -> str:
        """The settings."""
        return f"limit={self.limit}, gains={self.gains}"
