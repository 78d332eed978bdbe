"""The maze scene: the arm with its cylinder, and boxes that become the walls and floor of each environment's maze."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ppt_rl.arms import Arm
from ppt_rl.envs.maze.geometry import Array, Corridor, Face, Floor
from ppt_rl.envs.models.arm import CYLINDER, Tool
from ppt_rl.envs.models.table import table_scene

__all__ = ["MAX_FACES", "MAX_FLOORS", "PIECE_NAMES", "boxes_of", "check_pieces", "maze_scene"]

#: Number of wall and floor boxes in the compiled model, used or not. All mazes share one model and differ in numbers
#: only, so a new maze needs no compilation.
MAX_FACES, MAX_FLOORS = 48, 28
#: Their names, in the order of the model.
PIECE_NAMES = tuple(
    f"{kind}{index}" for kind, count in (("wall", MAX_FACES), ("floor", MAX_FLOORS)) for index in range(count)
)
#: Thickness of the floor, and of the walls [m].
_SLAB, _WALL = 0.01, 0.01
#: MuJoCo's ``solimp`` of a contact: zero impedance at first touch, almost full impedance 2 mm deeper. With it a lightly
#: pressed tool rests on the floor; with a contact that is stiff from the start it bounces at the physics' time step.
_SOFT = (0.0, 0.95, 0.002)
#: Position [m], orientation [-] and half size [m] of unused boxes, far below the table.
_UNUSED = ((0.0, 0.0, -5.0), (1.0, 0.0, 0.0, 0.0), (1e-3,) * 3)


def maze_scene(arm: Arm, tool: Tool = CYLINDER, *, physics_dt: float = 0.0005) -> Any:
    """MJCF of the maze scene with all boxes unused; :func:`boxes_of` tells where they belong.

    Contacts are declared as pairs of the tool and a box: MuJoCo looks for no other ones, and each has its own friction.

    Args:
        arm: the arm.
        tool: a tool without a bar.
        physics_dt: time step of the physics [s].

    Returns:
        A ``dm_control.mjcf.RootElement``.
    """
    root = table_scene(arm, tool, physics_dt=physics_dt)
    position, _, size = _UNUSED
    for kind, count, colour in (
        ("wall", MAX_FACES, [0.35, 0.50, 0.62, 0.75]),
        ("floor", MAX_FLOORS, [0.88, 0.86, 0.80, 1.0]),
    ):
        for index in range(count):
            root.worldbody.add(
                "geom", name=f"{kind}{index}", type="box", size=size, pos=position, rgba=colour,
                contype=8, conaffinity=0, group=2,
            )  # fmt: skip
            root.contact.add(
                "pair", geom1="stem", geom2=f"{kind}{index}", condim=3, friction=[0.25, 0.25, 0, 0, 0], solimp=_SOFT,
            )  # fmt: skip
    return root


def check_pieces(corridor: Corridor) -> None:
    """Raise if a maze has more pieces than the compiled model has boxes.

    Args:
        corridor: geometry of the maze.

    Raises:
        ValueError: if it has too many walls or floors.
    """
    for kind, pieces, room in (("wall", corridor.faces, MAX_FACES), ("floor", corridor.floors, MAX_FLOORS)):
        if len(pieces) > room:
            raise ValueError(f"the maze has {len(pieces)} pieces of {kind}; expected at most {room}. Shorten it.")


def boxes_of(corridor: Corridor) -> Array:
    """The boxes of a maze, in the order of :data:`PIECE_NAMES`.

    Args:
        corridor: geometry of the maze.

    Returns:
        ``(76, 10)``: position [m], orientation ``(w, x, y, z)`` and half sizes [m] of each box. Unused ones are tiny
        and far below the table.

    Raises:
        ValueError: if the maze has more pieces than the model has boxes.
    """
    check_pieces(corridor)
    unused = np.concatenate(_UNUSED)
    boxes = np.tile(unused, (len(PIECE_NAMES), 1))
    for first, pieces in ((0, map(_wall, corridor.faces)), (MAX_FACES, map(_slab, corridor.floors))):
        for index, piece in enumerate(pieces, start=first):
            boxes[index] = np.concatenate(piece)
    return boxes


def _wall(face: Face) -> tuple[Array, tuple[float, ...], Array]:
    """Position, orientation and half sizes of the box behind a face, from below the table top to the wall's top."""
    begin, end, direction = _extended(face)
    normal = face.outward * np.asarray([-direction[1], direction[0]])
    middle = 0.5 * (begin + end) + 0.5 * _WALL * normal
    low = -_SLAB
    size = np.asarray([0.5 * float(np.linalg.norm(end - begin)), 0.5 * _WALL, 0.5 * (face.top - low)])
    half = 0.5 * math.atan2(direction[1], direction[0])
    return np.asarray([*middle, 0.5 * (face.top + low)]), (math.cos(half), 0.0, 0.0, math.sin(half)), size


def _slab(floor: Floor) -> tuple[Array, tuple[float, ...], Array]:
    """Position, orientation and half sizes of the box under a piece of floor; its top runs from begin to end."""
    begin, end, direction = _extended(floor)
    yaw, pitch = math.atan2(direction[1], direction[0]), -math.asin(float(np.clip(direction[2], -1.0, 1.0)))
    # Rz(yaw) Ry(pitch)
    cy, sy, cp, sp = math.cos(yaw / 2), math.sin(yaw / 2), math.cos(pitch / 2), math.sin(pitch / 2)
    up = np.asarray([math.sin(pitch) * math.cos(yaw), math.sin(pitch) * math.sin(yaw), math.cos(pitch)])
    middle = 0.5 * (begin + end) - 0.5 * _SLAB * up
    size = np.asarray([0.5 * float(np.linalg.norm(end - begin)), floor.half_width, 0.5 * _SLAB])
    return middle, (cy * cp, -sy * sp, cy * sp, sy * cp), size


def _extended(piece: Face | Floor) -> tuple[Array, Array, Array]:
    """Begin and end of a piece including its extensions [m], and the unit vector from begin to end."""
    edge = piece.end - piece.begin
    direction = edge / float(np.linalg.norm(edge))
    return piece.begin - piece.over_begin * direction, piece.end + piece.over_end * direction, direction
