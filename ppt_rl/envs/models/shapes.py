"""Triangle meshes of the shells of an arm: cylinders with rounded edges, and bent tubes with round ends."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ppt_rl.arms import Shell

__all__ = ["Mesh", "shell_mesh"]

Array = NDArray[np.float64]
#: ``(V, 3)`` vertices [m] and ``(F, 3)`` indices of the corners of triangles, anticlockwise as seen from outside.
Mesh = tuple[Array, NDArray[np.int32]]
#: Corners of a circle, points along a bent tube, points of a rounded edge and of a round end.
_AROUND, _ALONG, _EDGE, _END = 30, 10, 4, 5


@lru_cache(maxsize=256)
def shell_mesh(shell: Shell) -> Mesh:
    """The surface of a shell: closed, its triangles anticlockwise as seen from outside.

    Args:
        shell: a ``"cylinder"`` or a ``"tube"``, as :class:`~ppt_rl.arms.Shell` defines them.

    Returns:
        Vertices in the link's frame [m] and triangles. They are shared: do not change them.

    Raises:
        ValueError: if the shape of the shell has no mesh.
    """
    start, end = np.asarray(shell.start, dtype=float), np.asarray(shell.end, dtype=float)
    if shell.shape == "cylinder":
        return _swept(*_cylinder(start, end, shell.radius, shell.edge))
    if shell.shape == "tube":
        via = 0.5 * (start + end) if shell.via is None else np.asarray(shell.via, dtype=float)
        return _swept(*_tube(start, via, end, shell.radius, shell.end_radius or shell.radius))
    raise ValueError(f"a shell is a {shell.shape!r}; expected a 'cylinder' or a 'tube', of which there are meshes.")


def _cylinder(start: Array, end: Array, radius: float, edge: float) -> tuple[Array, Array, Array]:
    """Centres, directions and radii of the circles of a cylinder whose edges are rounded with the radius ``edge``."""
    length = float(np.linalg.norm(end - start))
    edge = min(edge, 0.5 * length, 0.95 * radius)
    angle = np.linspace(0.0, 0.5 * math.pi, _EDGE)
    along, inward = edge * (1 - np.cos(angle)), edge * (1 - np.sin(angle))  # from the filled end to the widest circle
    at = np.concatenate([along, length - along[::-1]])
    radii = radius - np.concatenate([inward, inward[::-1]])
    direction = (end - start) / length
    return start + at[:, None] * direction, np.tile(direction, (len(at), 1)), radii


def _tube(start: Array, via: Array, end: Array, radius: float, end_radius: float) -> tuple[Array, Array, Array]:
    """Circles of a tube along a quadratic Bézier curve, whose radius changes evenly, with half a ball at each end."""
    t = np.linspace(0.0, 1.0, _ALONG)[:, None]
    centres = (1 - t) ** 2 * start + 2 * t * (1 - t) * via + t**2 * end
    ways = 2 * (1 - t) * (via - start) + 2 * t * (end - via)
    ways /= np.linalg.norm(ways, axis=-1, keepdims=True)
    radii = radius + (end_radius - radius) * t[:, 0]
    angle = np.linspace(0.02, 0.5 * math.pi, _END)[:-1]
    before = start - radius * np.cos(angle)[:, None] * ways[0]
    after = end + end_radius * np.cos(angle[::-1])[:, None] * ways[-1]
    return (
        np.concatenate([before, centres, after]),
        np.concatenate([np.tile(ways[0], (len(angle), 1)), ways, np.tile(ways[-1], (len(angle), 1))]),
        np.concatenate([radius * np.sin(angle), radii, end_radius * np.sin(angle[::-1])]),
    )


def _swept(centres: Array, directions: Array, radii: Array) -> Mesh:
    """The closed surface through circles, each across its direction; the first and the last one are filled."""
    sides = _across(directions)
    angle = np.linspace(0.0, 2 * math.pi, _AROUND, endpoint=False)
    out = (
        np.cos(angle)[None, :, None] * sides[:, None]
        + np.sin(angle)[None, :, None] * np.cross(directions, sides)[:, None]
    )
    rings = centres[:, None] + radii[:, None, None] * out
    vertices = np.concatenate([rings.reshape(-1, 3), centres[:1], centres[-1:]])
    first, last = len(vertices) - 2, len(vertices) - 1
    here = np.arange(_AROUND)
    following = (here + 1) % _AROUND
    low = _AROUND * np.arange(len(rings) - 1)[:, None]
    a, b = low + here, low + following
    c, d = a + _AROUND, b + _AROUND
    top = _AROUND * (len(rings) - 1)
    faces = [
        np.stack([a, b, d], -1).reshape(-1, 3),
        np.stack([a, d, c], -1).reshape(-1, 3),
        np.stack([np.full(_AROUND, first), following, here], -1),
        np.stack([np.full(_AROUND, last), top + here, top + following], -1),
    ]
    return vertices, np.concatenate(faces).astype(np.int32)


def _across(directions: Array) -> Array:
    """Unit vectors across directions, each as close to the one before as it can be: the surface is not twisted."""
    first = np.eye(3)[np.abs(directions[0]).argmin()]
    sides = []
    for direction in directions:
        first = first - (first @ direction) * direction
        first = first / np.linalg.norm(first)
        sides.append(first)
    return np.stack(sides)
