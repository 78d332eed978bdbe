"""The smallest change of an effort that satisfies a few linear constraints, and stays near the last effort."""

from __future__ import annotations

from itertools import combinations

import torch
from torch import Tensor

from ppt_rl.functional.checks import all_at_most, require_last_dim
from ppt_rl.functional.shape_checks import require_same_batch, require_trailing

__all__ = ["MOST_HALF_SPACES", "nearest_in_ball", "project_half_space", "project_half_spaces"]

#: Most constraints whose active sets are tried one by one: 16 sets.
MOST_HALF_SPACES = 4
#: Halvings of the interval in which the weight of the last effort lies.
_HALVINGS = 30


def project_half_space(effort: Tensor, normal: Tensor, offset: Tensor) -> Tensor:
    r"""The point of a half-space that is nearest to an effort.

    .. math:: u' = u - \frac{\max(0,\ a^\top u - b)}{\lVert a \rVert^2}\,a

    Args:
        effort: ``(*B, n)`` u.
        normal: ``(*B, n)`` a; where it is zero, the effort passes unchanged.
        offset: ``(*B, 1)`` b.

    Returns:
        ``(*B, n)`` the effort with ``a . u' <= b`` up to rounding; bit by bit the given one where that holds already.

    Raises:
        ValueError: if a shape does not fit.
    """
    require_trailing("effort", effort, "N")
    require_last_dim("normal", normal, effort.shape[-1])
    require_last_dim("offset", offset, 1)
    require_same_batch(effort=effort, normal=normal, offset=offset)
    normal, offset = _unit(normal, offset)
    excess = (normal * effort).sum(-1, keepdim=True) - offset
    return torch.where(excess > 0, effort - excess * normal, effort)


def project_half_spaces(effort: Tensor, normals: Tensor, offsets: Tensor) -> Tensor:
    r"""The point of the intersection of at most four half-spaces that is nearest to an effort, exactly.

    .. math:: \min_{u'} \lVert u' - u \rVert^2 \quad \text{so that} \quad a_i^\top u' \le b_i

    The solution lies on the planes of some of the constraints, so the nearest point of every such set is computed, and
    the nearest one of those that satisfy all constraints is taken. Where the constraints contradict each other, the
    result is the candidate that violates them least.

    Args:
        effort: ``(*B, n)`` u.
        normals: ``(*B, m, n)`` one a in each row; a row of zeros is no constraint.
        offsets: ``(*B, m)`` b.

    Returns:
        ``(*B, n)`` the effort within the constraints, up to rounding; bit by bit the given one where it is within them.

    Raises:
        ValueError: if a shape does not fit, or there are more than four constraints.
    """
    require_trailing("effort", effort, "N")
    require_trailing("normals", normals, "M", effort.shape[-1])
    count = normals.shape[-2]
    require_last_dim("offsets", offsets, count)
    require_same_batch(effort=effort, **{"normals[..., 0]": normals[..., 0], "offsets": offsets})
    if not 1 <= count <= MOST_HALF_SPACES:
        raise ValueError(f"there are {count} constraints; expected 1 to {MOST_HALF_SPACES}.")
    if count == 1:
        return project_half_space(effort, normals[..., 0, :], offsets)
    normals, offsets = _unit(normals, offsets.unsqueeze(-1))
    offsets = offsets.squeeze(-1)
    excess = (normals @ effort.unsqueeze(-1)).squeeze(-1) - offsets
    best, score = effort, _score(effort, effort, normals, offsets)
    for size in range(1, min(count, effort.shape[-1]) + 1):
        for chosen in map(list, combinations(range(count), size)):
            candidate = _onto(effort, normals[..., chosen, :], excess[..., chosen])
            own = _score(candidate, effort, normals, offsets)
            better = own < score
            best, score = torch.where(better, candidate, best), torch.where(better, own, score)
    return torch.where((excess <= 0).all(-1, keepdim=True), effort, best)


def nearest_in_ball(effort: Tensor, normals: Tensor, offsets: Tensor, last: Tensor, most: float) -> Tensor:
    r"""As :func:`project_half_spaces`, with a largest change from the last effort as well.

    .. math:: \min_{u'} \lVert u' - u \rVert^2 \quad \text{so that} \quad
        a_i^\top u' \le b_i, \quad \lVert u' - u_{last} \rVert \le c

    With a multiplier for the last constraint, the solution is the projection of ``(1 - t) u + t u_last`` for one ``t``
    in [0, 1], and the change falls as ``t`` grows; thirty halvings of the interval find it. Where no effort satisfies
    all of them, the half-spaces win: the result is their point that is nearest to the last effort.

    Args:
        effort: ``(*B, n)`` u.
        normals: ``(*B, m, n)`` one a in each row.
        offsets: ``(*B, m)`` b.
        last: ``(*B, n)`` last effort.
        most: c, largest length of the change, in the unit of the effort.

    Returns:
        ``(*B, n)`` the effort within the constraints, up to rounding. Its gradient takes ``t`` as given.

    Raises:
        ValueError: if a shape does not fit.
    """
    require_last_dim("last", last, effort.shape[-1])

    def at(share: Tensor) -> Tensor:
        return project_half_spaces(effort + share * (last - effort), normals, offsets)

    def change(value: Tensor) -> Tensor:
        return torch.linalg.vector_norm(value - last, dim=-1, keepdim=True)

    low = torch.zeros_like(effort[..., :1])
    free = at(low)
    if all_at_most(change(free), most):  # the usual case
        return free
    high = torch.ones_like(low)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        fits = change(at(middle)) <= most
        low, high = torch.where(fits, low, middle), torch.where(fits, middle, high)
    return torch.where(change(free) <= most, free, at(high))


def _unit(normal: Tensor, offset: Tensor) -> tuple[Tensor, Tensor]:
    """The same half-spaces with normals of length 1; one with a normal of zero becomes one that always holds."""
    size = torch.linalg.vector_norm(normal, dim=-1, keepdim=True)
    there = size > torch.finfo(size.dtype).tiny
    size = torch.where(there, size, 1.0)
    return torch.where(there, normal / size, 0.0), torch.where(there, offset / size, 1.0)


def _onto(effort: Tensor, normals: Tensor, excess: Tensor) -> Tensor:
    """The nearest point on the intersection of some planes; where these are parallel, no finite number."""
    empty = ~normals.any(-1)
    gram = normals @ normals.mT + torch.diag_embed(empty.to(normals.dtype))
    multipliers, _ = torch.linalg.solve_ex(gram, torch.where(empty, 0.0, excess).unsqueeze(-1))
    return effort - (normals.mT @ multipliers).squeeze(-1)


def _score(candidate: Tensor, effort: Tensor, normals: Tensor, offsets: Tensor) -> Tensor:
    """``(*B, 1)`` the smaller the better: distance among those within the constraints, else the violation."""
    distance = torch.linalg.vector_norm(candidate - effort, dim=-1, keepdim=True)
    violation = ((normals @ candidate.unsqueeze(-1)).squeeze(-1) - offsets).amax(-1, keepdim=True)
    scale = 1 + offsets.abs().amax(-1, keepdim=True) + torch.linalg.vector_norm(effort, dim=-1, keepdim=True)
    share = violation / scale
    allowed = 100 * torch.finfo(effort.dtype).eps
    within = distance / (distance + scale)  # in [0, 1)
    score = torch.where(share <= allowed, within, 2 + share)
    return torch.where(score.isfinite(), score, torch.inf)
