"""The maze scene: the arm with its cylinder, and walls and floor whose places are written for every environment."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ppt_rl.arms import Arm
from ppt_rl.envs.maze.geometry import Array, Corridor, Face, Floor
from ppt_rl.envs.models.arm import CYLINDER, Tool
from ppt_rl.envs.models.table import table_scene

__all__ = ["MAX_FACES", "MAX_FLOORS", "check_pieces", "maze_scene", "write_corridor"]

#: Pieces in every compiled maze, used or not: so mazes differ in numbers only, and nothing is compiled anew.
MAX_FACES, MAX_FLOORS = 48, 28
#: Thickness of the floor, and of the walls [m].
_SLAB, _WALL = 0.01, 0.01
#: Impedance of a contact, from nothing at first touch to all within 2 mm: a tool that is pressed on lightly then rests,
#: where a contact that is stiff from the start lets it hop with the physics' time step.
_SOFT = (0.0, 0.95, 0.002)
#: Where unused pieces are, far under the table, and their half size [m].
_AWAY, _TINY = (0.0, 0.0, -5.0), 1e-3


def maze_scene(arm: Arm, tool: Tool = CYLINDER, *, physics_dt: float = 0.0005) -> Any:
    """MJCF of the maze scene, its pieces still unused: :func:`write_corridor` places them.

    Contacts are declared pair by pair, tool against piece: only these are looked for, and each has its own friction.

    Args:
        arm: the arm.
        tool: a tool without a bar.
        physics_dt: time step of the physics [s].

    Returns:
        A ``dm_control.mjcf.RootElement``.
    """
    root = table_scene(arm, tool, physics_dt=physics_dt)
    for kind, count, colour in (
        ("wall", MAX_FACES, [0.35, 0.50, 0.62, 0.75]),
        ("floor", MAX_FLOORS, [0.88, 0.86, 0.80, 1.0]),
    ):
        for index in range(count):
            root.worldbody.add(
                "geom", name=f"{kind}{index}", type="box", size=[_TINY] * 3, pos=_AWAY, rgba=colour,
                contype=8, conaffinity=0, group=2,
            )  # fmt: skip
            root.contact.add(
                "pair", geom1="stem", geom2=f"{kind}{index}", condim=3, friction=[0.25, 0.25, 0, 0, 0], solimp=_SOFT,
            )  # fmt: skip
    return root


def check_pieces(corridor: Corridor) -> None:
    """Refuse a maze that has more pieces than the compiled scene.

    Args:
        corridor: the maze.

    Raises:
        ValueError: if it has more walls or floors.
    """
    for kind, pieces, room in (("wall", corridor.faces, MAX_FACES), ("floor", corridor.floors, MAX_FLOORS)):
        if len(pieces) > room:
            raise ValueError(f"the maze has {len(pieces)} pieces of {kind}; expected at most {room}. Shorten it.")


def write_corridor(model: Any, corridor: Corridor, friction: float) -> None:
    """Write a maze into a compiled model of :func:`maze_scene`.

    Args:
        model: ``mujoco.MjModel``, changed in place.
        corridor: the maze.
        friction: of walls and floor on the tool [-].

    Raises:
        ValueError: if the maze has more pieces than the model.
    """
    check_pieces(corridor)
    pieces = {"wall": [_wall(face) for face in corridor.faces], "floor": [_slab(floor) for floor in corridor.floors]}
    for kind, room in (("wall", MAX_FACES), ("floor", MAX_FLOORS)):
        first = model.geom(f"{kind}0").id
        for index in range(room):
            used = index < len(pieces[kind])
            place, turn, size = pieces[kind][index] if used else (_AWAY, (1.0, 0.0, 0.0, 0.0), (_TINY,) * 3)
            _write_box(model, first + index, place, turn, size)
    model.pair_friction[:, :2] = friction


def _write_box(model: Any, geom: int, place: Any, turn: Any, size: Any) -> None:
    """Place a box, with what the compiler derives from its size and place for the search of contacts."""
    model.geom_pos[geom], model.geom_quat[geom], model.geom_size[geom] = place, turn, size
    model.geom_rbound[geom] = np.linalg.norm(size)
    model.geom_aabb[geom] = [0.0, 0.0, 0.0, *size]
    model.geom_sameframe[geom] = 0


def _wall(face: Face) -> tuple[Array, tuple[float, ...], Array]:
    """Place, orientation and half sizes of the box behind a face, from under the table's top up."""
    way = face.end - face.begin
    length = float(np.linalg.norm(way))
    way = way / length
    normal = face.outward * np.asarray([-way[1], way[0]])
    begin, end = face.begin - face.over_begin * way, face.end + face.over_end * way
    middle = 0.5 * (begin + end) + 0.5 * _WALL * normal
    low = -_SLAB
    size = np.asarray([0.5 * float(np.linalg.norm(end - begin)), 0.5 * _WALL, 0.5 * (face.top - low)])
    half = 0.5 * math.atan2(way[1], way[0])
    return np.asarray([*middle, 0.5 * (face.top + low)]), (math.cos(half), 0.0, 0.0, math.sin(half)), size


def _slab(floor: Floor) -> tuple[Array, tuple[float, ...], Array]:
    """Place, orientation and half sizes of the box under a piece of floor; its top runs from begin to end."""
    way = floor.end - floor.begin
    length = float(np.linalg.norm(way))
    way = way / length
    begin, end = floor.begin - floor.over_begin * way, floor.end + floor.over_end * way
    yaw, pitch = math.atan2(way[1], way[0]), -math.asin(float(np.clip(way[2], -1.0, 1.0)))
    # Rz(yaw) Ry(pitch)
    cy, sy, cp, sp = math.cos(yaw / 2), math.sin(yaw / 2), math.cos(pitch / 2), math.sin(pitch / 2)
    up = np.asarray([math.sin(pitch) * math.cos(yaw), math.sin(pitch) * math.sin(yaw), math.cos(pitch)])
    middle = 0.5 * (begin + end) - 0.5 * _SLAB * up
    size = np.asarray([0.5 * float(np.linalg.norm(end - begin)), floor.half_width, 0.5 * _SLAB])
    return middle, (cy * cp, -sy * sp, cy * sp, sy * cp), size
