"""Checks that a maze lies within the arm's reach and can be driven through."""

from __future__ import annotations

import math

import numpy as np

from ppt_rl.arms.arm import Limits
from ppt_rl.envs.maze.geometry import Array, Corridor, Floor
from ppt_rl.envs.maze.layout import MazeLayout

__all__ = ["check_corridor"]

#: Least distance of the centre line from the base's axis, and of its corners from the base's y axis, as shares of the
#: arm's shortest reach [-].
_NEAREST, _IN_FRONT = 0.8, 0.5
#: The steepest ramp [rad].
_STEEPEST = math.radians(25.0)
#: Thickness of a wall, and least distance between the walls of two stretches of corridor [m].
_WALL, _APART = 0.01, 0.008


def check_corridor(corridor: Corridor, layout: MazeLayout, reach: Limits) -> None:
    """Raise if a maze cannot be driven through.

    Args:
        corridor: geometry of the maze.
        layout: the maze, for its width.
        reach: distances from the base's axis between which the corners of the centre line must lie [m].

    Raises:
        ValueError: if the maze leaves the arm's reach, is too narrow somewhere, crosses or touches itself, a straight
            is too short for its corners, or a ramp is too steep.
    """
    points, travelled = _samples(corridor.centre[:, :2])
    _check_reach(corridor.centre, points, reach)
    for piece in corridor.floors:
        _check_slope(piece)
    _check_width(corridor, points[travelled > 0.5 * layout.width], 0.5 * layout.width)  # beyond the start's own wall
    _check_separation(points, travelled, layout.width)


def _check_reach(centre: Array, points: Array, reach: Limits) -> None:
    corners = np.linalg.norm(centre[:, :2], axis=1)
    between = np.linalg.norm(points, axis=1).min()
    inside = reach.low <= corners.min() and corners.max() <= reach.high and between >= _NEAREST * reach.low
    front = _IN_FRONT * reach.low  # [m]
    if not inside or centre[:, 0].min() < front:
        raise ValueError(
            f"the maze lies {min(corners.min(), between):.2f} to {corners.max():.2f} m from the base; expected "
            f"{reach.low} to {reach.high} m, in front of it (x above {front:.2f} m). "
            "Move its start, or make it shorter."
        )
    if centre[:, 2].min() < 0.0:
        raise ValueError(
            f"the floor goes down to {centre[:, 2].min():.3f} m, below the table top; expected 0 m or more. "
            "Raise the layout's height."
        )


def _check_slope(piece: Floor) -> None:
    rise, run = piece.end[2] - piece.begin[2], float(np.linalg.norm(piece.end[:2] - piece.begin[:2]))
    if abs(math.atan2(rise, run)) > _STEEPEST:
        raise ValueError(
            f"a ramp rises {rise:.3f} m over {run:.3f} m; expected at most {math.degrees(_STEEPEST):.0f} degrees. "
            "Make its straight longer."
        )


def _check_width(corridor: Corridor, points: Array, half: float) -> None:
    """Raise if a wall is nearer to ``points`` of the centre line than half the width, or has no length."""
    begin, end = (np.asarray([face[i] for face in corridor.faces[1:]]) for i in (0, 1))
    gap = _distances(points, begin, end).min(-1)
    if gap.min() < half - 1e-6:
        x, y = points[int(gap.argmin())]
        raise ValueError(
            f"a wall is {gap.min() * 1e3:.1f} mm from the centre line at ({x:.2f}, {y:.2f}); expected at least "
            f"{half * 1e3:.1f} mm. The maze crosses itself, or a straight is too short for its corners."
        )
    if (np.linalg.norm(end - begin, axis=1) < 1e-6).any():
        raise ValueError("a wall has no length: a straight is too short for the corners at its ends. Make it longer.")


def _check_separation(points: Array, travelled: Array, width: float) -> None:
    """Raise if two stretches of corridor that are far apart along the centre line are close to each other."""
    apart = np.linalg.norm(points[:, None] - points[None], axis=-1)
    along = np.abs(travelled[:, None] - travelled[None])
    near = (along > 2 * width + 0.06) & (apart < width + 2 * _WALL + _APART)
    if near.any():
        x, y = points[int(near.any(1).argmax())]
        raise ValueError(
            f"two stretches of the maze meet near ({x:.2f}, {y:.2f}); expected at least {_APART * 1e3:.0f} mm between "
            "their walls. Change a turn, or make a straight longer."
        )


def _samples(line: Array, step: float = 0.004) -> tuple[Array, Array]:
    """Points every few millimetres along a polyline, and the distance travelled to each of them [m]."""
    lengths = np.linalg.norm(np.diff(line, axis=0), axis=1)
    at = np.concatenate([[0.0], lengths.cumsum()])
    travelled = np.linspace(0.0, at[-1], max(2, math.ceil(at[-1] / step)))
    return np.stack([np.interp(travelled, at, line[:, i]) for i in (0, 1)], -1), travelled


def _distances(points: Array, begin: Array, end: Array) -> Array:
    """``(N, F)`` distances from points to line segments [m]."""
    edge = end - begin
    share = ((points[:, None] - begin) * edge).sum(-1) / np.maximum((edge * edge).sum(-1), 1e-12)
    foot = begin + np.clip(share, 0.0, 1.0)[..., None] * edge
    return np.linalg.norm(points[:, None] - foot, axis=-1)
