"""Geometry of a maze: where its centre line, its walls and its floor run."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ppt_rl.envs.maze.layout import Disc, MazeLayout, Straight, Turn

__all__ = ["WALL_HEIGHT", "Array", "Corridor", "Face", "Floor", "build_corridor"]

Array = NDArray[np.float64]

#: Height of the walls above the highest floor next to them [m].
WALL_HEIGHT = 0.05
#: Least length of the level ends of a straight with a ramp: the floor of a corner must not cover the ramp [m].
_LEVEL = 0.035
#: Least length of a ramp [m].
_RAMP = 0.005
#: Width of the strip of floor under each wall, and length of the floor beyond the open end [m].
_UNDER_WALL, _RUN_OUT = 0.001, 0.04
#: Number of straight pieces that approximate the wall on one side of a disc.
_CHORDS = 7


class Face(NamedTuple):
    """The inner face of a flat piece of wall, from ``begin`` to ``end``.

    Attributes:
        begin: ``(2,)`` point on the map [m].
        end: ``(2,)`` point on the map [m].
        outward: +1 if the body of the wall is to the left when looking from begin to end, -1 if it is to the right.
        top: height of the wall's upper edge [m].
        over_begin: length by which the body extends beyond ``begin``, to close the outside of a corner [m].
        over_end: length by which it extends beyond ``end`` [m].
    """

    begin: Array
    end: Array
    outward: float
    top: float
    over_begin: float = 0.0
    over_end: float = 0.0


class Floor(NamedTuple):
    """A flat piece of floor along the centre line, level or sloping.

    Attributes:
        begin: ``(3,)`` middle of the first edge [m].
        end: ``(3,)`` middle of the last edge [m].
        half_width: distance from the centre line to either side [m].
        over_begin: length by which a level piece extends beyond ``begin``, under a corner [m].
        over_end: length by which it extends beyond ``end`` [m].
    """

    begin: Array
    end: Array
    half_width: float
    over_begin: float = 0.0
    over_end: float = 0.0


class Corridor(NamedTuple):
    """The geometry of a maze.

    Attributes:
        centre: ``(P, 3)`` corners of the centre line, on the floor [m].
        half_width: ``(P - 1,)`` largest distance from the centre line to a wall along each of its pieces [m].
        faces: inner faces of the walls; the first one closes the start.
        floors: pieces of floor.
    """

    centre: Array
    half_width: Array
    faces: tuple[Face, ...]
    floors: tuple[Floor, ...]

    @property
    def length(self) -> float:
        """Length of the centre line on the map [m]."""
        return float(np.linalg.norm(np.diff(self.centre[:, :2], axis=0), axis=1).sum())


class _Side:
    """Corner points of the wall on one side, collected from the start to the open end."""

    def __init__(self, sign: float) -> None:
        self.sign = sign  # +1 left, -1 right
        self.points: list[Array] = []
        self.heights: list[float] = []  # of the floor along the face that ends at each point

    def add(self, point: Array, height: float) -> None:
        self.points.append(point)
        self.heights.append(height)

    def faces(self, thickness: float) -> list[Face]:
        points = self.points
        edges = [b - a for a, b in pairwise(points)]
        turns = [_angle_between(a, b) for a, b in pairwise(edges)]
        # Where the wall turns away from its own body, a wedge is open behind the corner; there both bodies are longer.
        over = [0.0, *(thickness * math.tan(max(0.0, -self.sign * turn) / 2) for turn in turns), 0.0]
        return [
            Face(points[i], points[i + 1], self.sign, self.heights[i + 1] + WALL_HEIGHT, over[i], over[i + 1])
            for i in range(len(edges))
        ]


def build_corridor(layout: MazeLayout, *, wall_thickness: float = 0.01) -> Corridor:
    """Compute where the centre line, the walls and the floor of a maze run.

    Corners are mitred, so the corridor keeps its width along every straight. Ramps lie between level ends, and pieces
    of floor meet edge to edge. A wall closes the start.

    Args:
        layout: the maze.
        wall_thickness: thickness of the walls [m].

    Returns:
        The corridor. Whether it can be driven through is checked by
        :func:`~ppt_rl.envs.maze.feasibility.check_corridor`.

    Raises:
        ValueError: if a straight is too short for its ramp, or a disc is not wider than the corridor.
    """
    half = 0.5 * layout.width
    heading, point = layout.heading, np.asarray([*layout.start, layout.height], dtype=float)
    left, right = sides = _Side(1.0), _Side(-1.0)
    centre, widths, floors = [point], [], []
    floor_over = wall_thickness
    for side in sides:
        side.add(point[:2] + side.sign * half * _normal(heading), point[2])
    for index, segment in enumerate(layout.segments):
        if isinstance(segment, Straight):
            following = layout.segments[index + 1] if index + 1 < len(layout.segments) else None
            turn = following.angle if isinstance(following, Turn) else 0.0
            over = half * math.tan(abs(turn) / 2) if following is not None else _RUN_OUT
            pieces = _straight_floors(point, heading, segment, half, (floor_over, over))
            floors += pieces
            floor_over = over
            centre += [piece.end for piece in pieces]
            widths += [half] * len(pieces)
            _add_straight_walls(sides, point, centre[-1], heading, half, turn)
            point = centre[-1]
        elif isinstance(segment, Turn):
            heading += segment.angle
        else:
            middle, point = _through_disc(point, heading, segment, half, sides)
            radius = 0.5 * segment.diameter
            centre += [middle, point]
            widths += [radius, radius]
            floors.append(_disc_floor(middle, heading, radius))
            heading += segment.angle
            floor_over = 0.0
    back = Face(left.points[0], right.points[0], -1.0, layout.height + WALL_HEIGHT, wall_thickness, wall_thickness)
    faces = (back, *left.faces(wall_thickness), *right.faces(wall_thickness))
    return Corridor(np.asarray(centre), np.asarray(widths), faces, tuple(floors))


def _add_straight_walls(
    sides: tuple[_Side, _Side], begin: Array, end: Array, heading: float, half: float, turn: float
) -> None:
    """Add the walls' corner points at the end of a straight, mitred for the turn that follows."""
    mitre = math.tan(turn / 2) * half  # along the straight [m]
    for side in sides:
        across = side.sign * half * _normal(heading)
        side.add(end[:2] + across - side.sign * mitre * _direction(heading), max(begin[2], end[2]))


def _straight_floors(
    point: Array, heading: float, segment: Straight, half: float, over: tuple[float, float]
) -> list[Floor]:
    """One level piece of floor, or a ramp between two level ends."""
    along = np.asarray([*_direction(heading), 0.0])
    end = point + segment.length * along + [0.0, 0.0, segment.rise]
    half_width = half + _UNDER_WALL
    if segment.rise == 0:
        return [Floor(point, end, half_width, *over)]
    level = max(_LEVEL, *(_corner_reach(half_width, size) for size in over))
    least = 2 * level + _RAMP
    if segment.length < least:
        raise ValueError(
            f"{segment} has no room for its ramp between level ends of {level:.3f} m; expected a length of at least "
            f"{least:.3f} m."
        )
    foot, crest = point + level * along, end - level * along
    return [
        Floor(point, foot, half_width, over[0], 0.0),
        Floor(foot, crest, half_width),
        Floor(crest, end, half_width, 0.0, over[1]),
    ]


def _corner_reach(half_width: float, over: float) -> float:
    """How far the floor of the previous straight, extended by ``over`` under the corner, reaches into this one [m]."""
    half = 0.5 * min(2 * math.atan2(over, half_width), math.pi)  # of the turn
    return over * math.cos(2 * half) + half_width * math.sin(2 * half) if over < half_width else _LEVEL


def _through_disc(
    point: Array, heading: float, disc: Disc, half: float, sides: tuple[_Side, _Side]
) -> tuple[Array, Array]:
    """Add the walls of a disc; return its centre and the point where the corridor leaves it."""
    radius = 0.5 * disc.diameter
    if radius <= half:
        raise ValueError(f"Disc.diameter is {disc.diameter} m in a corridor {2 * half} m wide; expected a wider disc.")
    depth = math.sqrt(radius**2 - half**2)  # from the mouth to the disc's centre
    opening = math.asin(half / radius)
    centre = point + depth * np.asarray([*_direction(heading), 0.0])
    out = heading + disc.angle
    for side in sides:
        first, last = heading + side.sign * (math.pi - opening), out + side.sign * opening
        for angle in np.linspace(first, last, _CHORDS + 1)[1:]:
            side.add(centre[:2] + radius * _direction(angle), point[2])
    return centre, centre + depth * np.asarray([*_direction(out), 0.0])


def _disc_floor(centre: Array, heading: float, half_width: float) -> Floor:
    along = half_width * np.asarray([*_direction(heading), 0.0])
    return Floor(centre - along, centre + along, half_width)


def _direction(angle: float) -> Array:
    return np.asarray([math.cos(angle), math.sin(angle)])


def _normal(angle: float) -> Array:
    """Unit vector to the left of a direction."""
    return np.asarray([-math.sin(angle), math.cos(angle)])


def _angle_between(first: Array, second: Array) -> float:
    cross, dot = first[0] * second[1] - first[1] * second[0], float(first @ second)
    return math.atan2(cross, dot)
