"""The heading of a tool that slides over a floor, and vectors in heading axes."""

from __future__ import annotations

import torch
from torch import Tensor

from ppt_rl.functional.checks import require_last_dim
from ppt_rl.functional.shape_checks import require_same_batch, require_trailing

__all__ = ["follow_heading", "from_heading", "to_heading"]


def to_heading(vector: Tensor, heading: Tensor) -> Tensor:
    r"""World axes to heading axes: x ahead, y to the left, z up.

    .. math:: v_h = R_z(-\psi)\, v

    Args:
        vector: ``(*B, 3)``, or ``(*B, 6)`` for a twist or wrench, of which both halves are rotated; world axes.
        heading: ``(*B, 1)`` psi, positive from the world's x axis to the left [rad].

    Returns:
        The vector in heading axes, of the same shape.

    Raises:
        ValueError: if the vector has neither 3 nor 6 numbers, or the heading not one.
    """
    _check_turned(vector, heading)
    return _turned(vector, -heading)


def from_heading(vector: Tensor, heading: Tensor) -> Tensor:
    """Heading axes to world axes: the inverse of :func:`to_heading`.

    Args:
        vector: ``(*B, 3)`` or ``(*B, 6)``, heading axes.
        heading: ``(*B, 1)`` [rad].

    Returns:
        The vector in world axes, of the same shape.

    Raises:
        ValueError: if the vector has neither 3 nor 6 numbers, or the heading not one.
    """
    _check_turned(vector, heading)
    return _turned(vector, heading)


def _check_turned(vector: Tensor, heading: Tensor) -> None:
    require_trailing("vector", vector, "N")
    if vector.shape[-1] not in (3, 6):
        raise ValueError(f"vector has shape {tuple(vector.shape)}; expected (*batch, 3) or (*batch, 6).")
    require_last_dim("heading", heading, 1)
    require_same_batch(vector=vector, heading=heading)


def _turned(vector: Tensor, angle: Tensor) -> Tensor:
    parts = vector.unflatten(-1, (-1, 3))
    cos, sin = angle.cos(), angle.sin()
    x, y, z = parts.unbind(-1)
    return torch.stack([cos * x - sin * y, sin * x + cos * y, z], -1).flatten(-2)


def follow_heading(
    heading: Tensor,
    velocity: Tensor,
    tangent: Tensor,
    touching: Tensor,
    *,
    dt: float,
    distance: float,
    patience: float,
    slow: float,
) -> Tensor:
    r"""Heading after one more control step: that of the recent motion, or along the wall where the tool is held up.

    .. math::
        h' \propto h + \frac{\max(0, v \cdot h)}{|v|}\,\frac{\Delta t}{\ell}\, v
        + c\,(1 - w)\,\frac{\Delta t}{T}\,t,
        \qquad w = \frac{|v|^2}{|v|^2 + v_s^2}

    The heading forgets over the distance ``l`` travelled, not over time: it rests while the tool rests. Backward motion
    does not turn it round.

    Args:
        heading: ``(*B, 1)`` heading, whose unit vector is h [rad].
        velocity: ``(*B, 2)`` horizontal velocity v of the tool, world axes [m/s].
        tangent: ``(*B, 2)`` unit vector t along the wall, world axes [-].
        touching: ``(*B, 1)`` bool c, whether there is a wall.
        dt: control step [s].
        distance: l, distance of travel over which the heading adapts [m].
        patience: T, time in which a tool that is held up turns along the wall [s].
        slow: v_s, a tool counts as held up below about this speed [m/s].

    Returns:
        ``(*B, 1)`` new heading in (-pi, pi] [rad].

    Raises:
        ValueError: if a shape does not fit.

    Source:
        Ours.
    """
    for name, value, size in (
        ("heading", heading, 1), ("velocity", velocity, 2), ("tangent", tangent, 2), ("touching", touching, 1),
    ):  # fmt: skip
        require_last_dim(name, value, size)
    ahead = torch.cat([heading.cos(), heading.sin()], -1)
    square = velocity.square().sum(-1, keepdim=True)
    along = (velocity * ahead).sum(-1, keepdim=True).clamp_min(0.0) / square.sqrt().clamp_min(1e-9)
    held_up = touching.to(heading.dtype) * slow**2 / (square + slow**2)
    ahead = ahead + along * (dt / distance) * velocity + held_up * (dt / patience) * tangent
    return torch.atan2(ahead[..., 1:], ahead[..., :1])
