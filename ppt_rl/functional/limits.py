"""Limits on an effort that keep its direction."""

from __future__ import annotations

import torch
from torch import Tensor

__all__ = ["factor_into", "scale_change", "scale_into"]


def factor_into(effort: Tensor, low: Tensor, high: Tensor) -> Tensor:
    r"""The largest factor up to 1 that brings an effort into a box around zero.

    .. math:: s = 1 / \max\Big(1,\ \max_i \max\big(\tau_i / h_i,\ \tau_i / l_i\big)\Big)

    Args:
        effort: ``(*B, N)`` effort: wrench [N, N m] or joint torque [N m].
        low: ``(N,)`` or ``(*B, N)`` lower bounds l, at most zero.
        high: likewise the upper bounds h, at least zero.

    Returns:
        ``(*B, 1)`` factor in [0, 1].
    """
    tiny = torch.finfo(effort.dtype).tiny  # a bound of zero lets nothing pass in its direction
    share = torch.maximum(effort / high.clamp_min(tiny), effort / low.clamp_max(-tiny))
    return share.amax(-1, keepdim=True).clamp_min(1.0).reciprocal()


def scale_into(effort: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Scale a whole effort into a box around zero, so that it keeps its direction.

    A limit on each component by itself would turn the effort. A torque that does no work could then do work: for
    ``J^T wrench`` with the wrench at right angles to the twist, clipped joint by joint, no bound on the power is left.

    Args:
        effort: ``(*B, N)`` effort: wrench [N, N m] or joint torque [N m].
        low: ``(N,)`` or ``(*B, N)`` lower bounds, at most zero.
        high: likewise the upper bounds, at least zero.

    Returns:
        ``(*B, N)`` effort times :func:`factor_into`, within the bounds to the last digit.
    """
    return torch.minimum(torch.maximum(factor_into(effort, low, high) * effort, low), high)


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
