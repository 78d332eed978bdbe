"""What an effort does to a velocity while it is held: quadratic forms of the inertia, rounded to the safe side."""

from __future__ import annotations

import torch
from torch import Tensor

__all__ = ["accelerating_power", "coupling", "kinetic_energy", "require_inertia_of", "root", "signed_root"]


def require_inertia_of(effort: Tensor, inertia: Tensor) -> None:
    """Raise unless an inertia fits an effort.

    Args:
        effort: ``(*B, N)``, or a velocity of that size.
        inertia: ``(N,)`` by axis or a matrix ``(*B, N, N)``.

    Raises:
        ValueError: if it has another shape.
    """
    size = effort.shape[-1]
    if inertia.shape != (size,) and inertia.shape[-2:] != (size, size):
        raise ValueError(
            f"inertia has shape {tuple(inertia.shape)}; expected ({size},) by axis, or a matrix ({size}, {size}) for "
            f"the effort {tuple(effort.shape)}."
        )


def accelerating_power(effort: Tensor, inertia: Tensor, ulp: float) -> Tensor:
    """``effort . M^-1 effort``, rounded up: how fast an effort raises its own power.

    Args:
        effort: ``(*B, N)`` [N, N m].
        inertia: M, ``(N,)`` by axis or a matrix ``(*B, N, N)`` [kg, kg m^2].
        ulp: distance from 1 to the next number of the coarsest input.

    Returns:
        ``(*B, 1)`` [W/s].
    """
    return _product(effort, effort, inertia) * (1 + 0.5 * (effort.shape[-1] + 6) * ulp)


def coupling(one: Tensor, other: Tensor, inertia: Tensor, doubt: Tensor) -> Tensor:
    """``one . M^-1 other`` plus a bound on its rounding error: how fast one effort raises the power of the other.

    Args:
        one: ``(*B, N)`` [N, N m].
        other: ``(*B, N)`` [N, N m].
        inertia: M, ``(N,)`` by axis or a matrix ``(*B, N, N)`` [kg, kg m^2].
        doubt: ``(*B, 1)`` the bound [W/s].

    Returns:
        ``(*B, 1)`` [W/s].
    """
    return _product(one, other, inertia) + doubt


def kinetic_energy(flow: Tensor, inertia: Tensor) -> Tensor:
    """``flow . M flow / 2``.

    Args:
        flow: ``(*B, N)`` velocity [m/s, rad/s].
        inertia: M, ``(N,)`` by axis or a matrix ``(*B, N, N)`` [kg, kg m^2].

    Returns:
        ``(*B, 1)`` [J].
    """
    if inertia.shape == flow.shape[-1:]:
        return (0.5 * flow * flow * inertia).sum(-1, keepdim=True).clamp_min(0.0)
    column = flow.to(torch.float64).unsqueeze(-1)
    moved = inertia.to(torch.float64) @ column
    return (0.5 * column * moved).sum(-2).clamp_min(0.0).to(flow.dtype)


def root(b: Tensor, c: Tensor, limit: float | Tensor, eps: float) -> Tensor:
    r"""The positive root of ``g b + g^2 c = limit``, in a form in which nothing cancels.

    .. math:: g = \frac{2 P}{\max(2\epsilon,\ b + \sqrt{b^2 + 4 P c})}

    Args:
        b: ``(*B, 1)`` power at the beginning of a step, at least zero [W].
        c: ``(*B, 1)`` what an effort adds to its own power, at least zero [W].
        limit: P, at least zero [W].
        eps: smallest power that is divided by [W].

    Returns:
        ``(*B, 1)`` [-], possibly above 1.
    """
    return 2 * limit / (b + (b * b + 4 * limit * c).sqrt()).clamp_min(2 * eps)


def signed_root(b: Tensor, c: Tensor, limit: float | Tensor, eps: float) -> Tensor:
    r"""The same for a power with a sign: how much of an effort that brakes may be held before it drives too hard.

    .. math:: g = \frac{-b + \sqrt{b^2 + 4 P c}}{2 c} \quad (b < 0)

    Args:
        b: ``(*B, 1)`` power at the beginning of a step, negative where the effort brakes [W].
        c: ``(*B, 1)`` what an effort adds to its own power, at least zero [W].
        limit: P, at least zero [W].
        eps: smallest power that is divided by [W].

    Returns:
        ``(*B, 1)`` [-], possibly above 1 or infinite.
    """
    tiny = torch.finfo(b.dtype).tiny
    braking = ((b * b + 4 * limit * c).sqrt() - b) / (2 * c).clamp_min(tiny)
    return torch.where(b < 0, braking, root(b, c, limit, eps))


def _product(one: Tensor, other: Tensor, inertia: Tensor) -> Tensor:
    if inertia.shape == one.shape[-1:]:
        return (one * other / inertia).sum(-1, keepdim=True)
    column = other.to(torch.float64).unsqueeze(-1)
    solved = torch.linalg.solve(inertia.to(torch.float64), column)
    return (one.to(torch.float64).unsqueeze(-1) * solved).sum(-2).to(one.dtype)
