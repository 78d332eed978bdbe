"""Limits on an effort that keep its direction."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ppt_rl.functional.checks import all_at_most

__all__ = ["EffortBounds", "scale_change", "scale_into"]


class EffortBounds(NamedTuple):
    """A box around zero, and what :func:`scale_into` needs of it.

    Attributes:
        low: ``(N,)`` or ``(*B, N)`` lower bounds, at most zero, in the unit of the effort.
        high: likewise the upper bounds, at least zero.
        inverse_low: their reciprocals; those of a bound of zero are so large that nothing passes in its direction.
        inverse_high: likewise.
    """

    low: Tensor
    high: Tensor
    inverse_low: Tensor
    inverse_high: Tensor

    @classmethod
    def of(cls, low: Tensor, high: Tensor) -> EffortBounds:
        """Make bounds.

        Args:
            low: ``(N,)`` or ``(*B, N)`` lower bounds, at most zero.
            high: likewise the upper bounds, at least zero.

        Returns:
            The bounds.
        """
        tiny = torch.finfo(low.dtype).tiny
        return cls(low, high, low.clamp_max(-tiny).reciprocal(), high.clamp_min(tiny).reciprocal())


def scale_into(effort: Tensor, bounds: EffortBounds) -> tuple[Tensor, Tensor | None]:
    r"""Scale a whole effort into a box around zero, so that it keeps its direction.

    .. math:: \tau' = s\,\tau, \qquad
        s = 1 / \max\Big(1,\ \max_i \max\big(\tau_i / h_i,\ \tau_i / l_i\big)\Big)

    A limit on each component by itself would turn the effort. A torque that does no work could then do work: for
    ``J^T wrench`` with the wrench at right angles to the twist, clipped joint by joint, no bound on the power is left.

    Args:
        effort: ``(*B, N)`` effort: wrench [N, N m] or joint torque [N m].
        bounds: the box, with lower bounds l and upper bounds h.

    Returns:
        ``(*B, N)`` scaled effort, within the bounds to the last digit, and ``(*B, 1)`` factor s in [0, 1]; None where
        it is known to be 1 everywhere.
    """
    share = torch.maximum(effort * bounds.inverse_high, effort * bounds.inverse_low)
    if all_at_most(share, 1.0 - 2 * torch.finfo(effort.dtype).eps):  # the usual case
        return effort, None
    factor = share.amax(-1, keepdim=True).clamp_min(1.0).reciprocal()
    return torch.minimum(torch.maximum(factor * effort, bounds.low), bounds.high), factor


def scale_change(effort: Tensor, last: Tensor, largest: float) -> Tensor:
    r"""Limit the change of an effort from one control step to the next, keeping the direction of the change.

    .. math:: \tau' = \tau_{last} + (\tau - \tau_{last}) \min\Big(1,\ \frac{c}{\max_i |\tau_i - \tau_{last,i}|}\Big)

    The result lies on the line between two efforts, so it is within every convex set that holds both.

    Args:
        effort: ``(*B, N)`` wanted effort.
        last: ``(*B, N)`` effort of the last control step.
        largest: c, largest change of a component, in the unit of the effort.

    Returns:
        ``(*B, N)`` limited effort.
    """
    change = effort - last
    return last + change / (change.abs().amax(-1, keepdim=True) / largest).clamp_min(1.0)
