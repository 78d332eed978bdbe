"""Centre line, walls and floor of a maze, and the checks that it can be built and driven through."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ppt_rl.arms.arm import Limits
from ppt_rl.envs.maze.layout import Disc, MazeLayout, Straight, Turn

__all__ = ["WALL_HEIGHT", "Corridor", "Face", "Floor", "build_corridor", "check_corridor"]

Array = NDArray[np.float64]

#: Walls stand this high above the highest floor beside them [m].
WALL_HEIGHT = 0.05
#: How near the base's axis a straight between two corners may come, and how near its y axis a corner, as shares of the
#: arm's shortest reach [-].
_NEAREST, _IN_FRONT = 0.8, 0.5
#: Level ends of a straight with a ramp, at least: no floor of a corner may stand out over a ramp downwards [m].
_LEVEL = 0.035
#: The steepest ramp [rad].
_STEEPEST = math.radians(25.0)
#: How far the floor reaches under the walls, and beyond the open end [m].
_UNDER_WALL, _RUN_OUT = 0.001, 0.04
#: Chords of a disc's wall on one side, and the distance that two walls keep of each other [-], [m].
_CHORDS, _APART = 7, 0.008


class Face(NamedTuple):
    """A flat piece of wall, seen from inside: it runs from ``begin`` to ``end`` with the corridor on one side.

    Attributes:
        begin: ``(2,)`` on the map [m].
        end: ``(2,)`` on the map [m].
        outward: +1 where the wall's body lies to the left of the way from begin to end, -1 to the right.
        top: height of its upper edge [m].
        over_begin: by which the body reaches beyond ``begin``, to close the outer corner [m].
        over_end: likewise beyond ``end`` [m].
    """

    begin: Array
    end: Array
    outward: float
    top: float
    over_begin: float = 0.0
    over_end: float = 0.0


class Floor(NamedTuple):
    """A flat, maybe sloping piece of floor along the centre line.

    Attributes:
        begin: ``(3,)`` middle of its lower or upper edge [m].
        end: ``(3,)`` [m].
        half_width: to either side [m].
        over_begin: by which a level piece reaches beyond its begin, under a corner [m].
        over_end: likewise beyond its end [m].
    """

    begin: Array
    end: Array
    half_width: float
    over_begin: float = 0.0
    over_end: float = 0.0


class Corridor(NamedTuple):
    """A maze in numbers.

    Attributes:
        centre: ``(P, 3)`` corners of the centre line, on the floor [m].
        half_width: ``(P - 1,)`` from the centre line to the wall along each piece of it, at most [m].
        faces: the walls' inner faces.
        floors: pieces of floor.
    """

    centre: Array
    half_width: Array
    faces: tuple[Face, ...]
    floors: tuple[Floor, ...]

    @property
    def length(self) -> float:
        """Of the centre line on the map [m]."""
        return float(np.linalg.norm(np.diff(self.centre[:, :2], axis=0), axis=1).sum())


class _Side:
    """Points of one wall, collected along the way."""

    def __init__(self, sign: float) -> None:
        self.sign = sign  # +1 left, -1 right
        self.points: list[Array] = []
        self.heights: list[float] = []  # of the floor along the face that ends at a point

    def add(self, point: Array, height: float) -> None:
        self.points.append(point)
        self.heights.append(height)

    def faces(self, thickness: float) -> list[Face]:
        points = self.points
        ways = [b - a for a, b in pairwise(points)]
        turns = [_angle_between(a, b) for a, b in pairwise(ways)]
        # A wall that turns away from its own body leaves a wedge open behind the corner; there both bodies reach over.
        over = [0.0, *(thickness * math.tan(max(0.0, -self.sign * turn) / 2) for turn in turns), 0.0]
        return [
            Face(points[i], points[i + 1], self.sign, self.heights[i + 1] + WALL_HEIGHT, over[i], over[i + 1])
            for i in range(len(ways))
        ]


def build_corridor(layout: MazeLayout, *, wall_thickness: float = 0.01) -> Corridor:
    """Lay a maze out: where its centre line, walls and floor run.

    Corners are mitred, so the corridor keeps its width along every straight; ramps lie between level ends,
    and pieces of floor meet edge to edge. A wall closes the start.

    Args:
        layout: the maze.
        wall_thickness: [m].

    Returns:
        The corridor, not checked: see :func:`check_corridor`.
    """
    half = 0.5 * layout.width
    heading, point = layout.heading, np.asarray([*layout.start, layout.height], dtype=float)
    left, right = _Side(1.0), _Side(-1.0)
    centre, widths, floors = [point], [], []
    floor_over = wall_thickness
    for side in (left, right):
        side.add(point[:2] + side.sign * half * _normal(heading), point[2])
    for index, segment in enumerate(layout.segments):
        if isinstance(segment, Straight):
            following = layout.segments[index + 1] if index + 1 < len(layout.segments) else None
            turn = following.angle if isinstance(following, Turn) else 0.0
            over = half * math.tan(abs(turn) / 2) if following is not None else _RUN_OUT
            pieces = _straight(point, heading, segment, half, (floor_over, over))
            floors += pieces
            floor_over = over
            centre += [piece.end for piece in pieces]
            widths += [half] * len(pieces)
            end, floor = centre[-1], max(point[2], centre[-1][2])
            reach = math.tan(turn / 2) * half  # of the mitre, along the way
            for side in (left, right):
                across = side.sign * half * _normal(heading)
                side.add(end[:2] + across - side.sign * reach * _way(heading), floor)
            point = end
        elif isinstance(segment, Turn):
            heading += segment.angle
        else:
            centre_point, point = _through_disc(point, heading, segment, half, (left, right))
            radius = 0.5 * segment.diameter
            centre += [centre_point, point]
            widths += [radius, radius]
            floors.append(_chamber_floor(centre_point, heading, radius))
            heading += segment.angle
            floor_over = 0.0
    back = Face(left.points[0], right.points[0], -1.0, layout.height + WALL_HEIGHT, wall_thickness, wall_thickness)
    faces = (back, *left.faces(wall_thickness), *right.faces(wall_thickness))
    return Corridor(np.asarray(centre), np.asarray(widths), faces, tuple(floors))


def _straight(point: Array, heading: float, segment: Straight, half: float, over: tuple[float, float]) -> list[Floor]:
    way = np.asarray([*_way(heading), 0.0])
    end = point + segment.length * way + [0.0, 0.0, segment.rise]
    half_width = half + _UNDER_WALL
    if segment.rise == 0:
        return [Floor(point, end, half_width, *over)]
    level = max(_LEVEL, *(_corner_reach(half_width, size) for size in over))
    if segment.length < 2 * level + 0.005:
        raise ValueError(
            f"{segment} has no room for its ramp between level ends of {level:.3f} m; expected a length of at least "
            f"{2 * level + 0.005:.3f} m."
        )
    foot, crest = point + level * way, end - level * way
    return [
        Floor(point, foot, half_width, over[0], 0.0),
        Floor(foot, crest, half_width),
        Floor(crest, end, half_width, 0.0, over[1]),
    ]


def _corner_reach(half_width: float, over: float) -> float:
    """How far into a straight the floor of the one before it reaches, which goes on by ``over`` under the corner."""
    half = 0.5 * min(2 * math.atan2(over, half_width), math.pi)  # of the turn
    return over * math.cos(2 * half) + half_width * math.sin(2 * half) if over < half_width else _LEVEL


def _through_disc(
    point: Array, heading: float, disc: Disc, half: float, sides: tuple[_Side, _Side]
) -> tuple[Array, Array]:
    radius = 0.5 * disc.diameter
    if radius <= half:
        raise ValueError(f"Disc.diameter is {disc.diameter} m in a corridor {2 * half} m wide; expected a wider disc.")
    depth = math.sqrt(radius**2 - half**2)  # from the mouth to the disc's centre
    opening = math.asin(half / radius)
    centre = point + depth * np.asarray([*_way(heading), 0.0])
    out = heading + disc.angle
    for side in sides:
        first, last = heading + side.sign * (math.pi - opening), out + side.sign * opening
        for angle in np.linspace(first, last, _CHORDS + 1)[1:]:
            side.add(centre[:2] + radius * _way(angle), point[2])
    return centre, centre + depth * np.asarray([*_way(out), 0.0])


def _chamber_floor(centre: Array, heading: float, half_width: float) -> Floor:
    way = half_width * np.asarray([*_way(heading), 0.0])
    return Floor(centre - way, centre + way, half_width)


def check_corridor(corridor: Corridor, layout: MazeLayout, reach: Limits) -> None:
    """Refuse a maze that cannot be built or driven through.

    Args:
        corridor: of the layout.
        layout: the maze, for its width.
        reach: distance from the base's axis within which the centre line must have its corners [m].

    Raises:
        ValueError: if it leaves the arm's reach, is narrower than asked anywhere, crosses or touches itself, a straight
            is too short for its corners, or a ramp is too steep.
    """
    radius = np.linalg.norm(corridor.centre[:, :2], axis=1)
    between = np.linalg.norm(_samples(corridor.centre[:, :2])[0], axis=1).min()
    inside = reach.low <= radius.min() and radius.max() <= reach.high and between >= _NEAREST * reach.low
    front = _IN_FRONT * reach.low  # [m]
    if not inside or corridor.centre[:, 0].min() < front:
        raise ValueError(
            f"the maze lies {min(radius.min(), between):.2f} to {radius.max():.2f} m from the base; expected "
            f"{reach.low} to {reach.high} m, in front of it (x above {front:.2f} m). "
            "Move its start, or make it shorter."
        )
    if corridor.centre[:, 2].min() < 0.0:
        raise ValueError(f"the floor goes down to {corridor.centre[:, 2].min():.3f} m, into the table; raise height.")
    for piece in corridor.floors:
        rise, run = piece.end[2] - piece.begin[2], float(np.linalg.norm(piece.end[:2] - piece.begin[:2]))
        if abs(math.atan2(rise, run)) > _STEEPEST:
            raise ValueError(f"a ramp rises {rise:.3f} m over {run:.3f} m; expected at most 25 degrees: lengthen it.")
    _check_clearance(corridor, 0.5 * layout.width)


def _check_clearance(corridor: Corridor, half: float) -> None:
    """No wall nearer to the centre line than half the width, and no two stretches of corridor through one another."""
    begin, end = (np.asarray([face[i] for face in corridor.faces[1:]]) for i in (0, 1))
    points, travelled = _samples(corridor.centre[:, :2])
    inside = travelled > half  # the start is closed by a wall of its own
    gap = _distances(points[inside], begin, end).min(-1)
    if gap.min() < half - 1e-6:
        at = points[inside][int(gap.argmin())]
        raise ValueError(
            f"a wall stands {gap.min() * 1e3:.1f} mm from the centre line at ({at[0]:.2f}, {at[1]:.2f}); expected "
            f"{half * 1e3:.1f} mm. The maze crosses itself, or a straight is too short for its corners."
        )
    ways = end - begin
    if (np.linalg.norm(ways, axis=1) < 1e-6).any():
        raise ValueError("a wall has no length: a straight is too short for the corners at its ends. Lengthen it.")
    apart = np.linalg.norm(points[:, None] - points[None], axis=-1)
    along = np.abs(travelled[:, None] - travelled[None])
    near = (along > 4 * half + 0.06) & (apart < 2 * half + 2 * 0.01 + _APART)
    if near.any():
        at = points[int(near.any(1).argmax())]
        raise ValueError(f"the maze runs into itself near ({at[0]:.2f}, {at[1]:.2f}); expected stretches well apart.")


def _samples(line: Array, step: float = 0.004) -> tuple[Array, Array]:
    """Points every few millimetres of a polyline, and how far along each is."""
    lengths = np.linalg.norm(np.diff(line, axis=0), axis=1)
    at = np.concatenate([[0.0], lengths.cumsum()])
    travelled = np.linspace(0.0, at[-1], max(2, math.ceil(at[-1] / step)))
    return np.stack([np.interp(travelled, at, line[:, i]) for i in (0, 1)], -1), travelled


def _distances(points: Array, begin: Array, end: Array) -> Array:
    """``(N, F)`` distances of points to line segments."""
    way = end - begin
    share = ((points[:, None] - begin) * way).sum(-1) / np.maximum((way * way).sum(-1), 1e-12)
    foot = begin + np.clip(share, 0.0, 1.0)[..., None] * way
    return np.linalg.norm(points[:, None] - foot, axis=-1)


def _way(angle: float) -> Array:
    return np.asarray([math.cos(angle), math.sin(angle)])


def _normal(angle: float) -> Array:
    return np.asarray([-math.sin(angle), math.cos(angle)])


def _angle_between(first: Array, second: Array) -> float:
    cross, dot = first[0] * second[1] - first[1] * second[0], float(first @ second)
    return math.atan2(cross, dot)
