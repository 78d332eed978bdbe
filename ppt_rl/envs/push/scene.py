"""The pushing scene: a box and the outline of its goal on the table."""

from __future__ import annotations

from typing import Any

from ppt_rl.arms import Arm
from ppt_rl.envs.models import PADDLE, Tool, table_scene

__all__ = ["PUSH_BOX", "push_scene", "write_looks"]

#: Name of the box's body, joint and geom.
PUSH_BOX = "box"


#: Colours of the goal, of its marked side and the box's, and of the box.
_GREEN, _MARK, _BOX = (0.10, 0.62, 0.32, 1.0), (0.98, 0.84, 0.18, 1.0), (0.85, 0.38, 0.16, 1.0)
#: Half width of the lines of the outline, half their height, and how far a face of the box is painted outwards [m].
_LINE, _HEIGHT, _PAINT = 0.0022, 0.0004, 0.0003
_VISUAL: dict[str, Any] = {"contype": 0, "conaffinity": 0, "group": 2, "mass": 0}


def _add_goal(world: Any) -> None:
    goal = world.add("body", name="goal", pos=[0.65, 0, 0])
    goal.add("geom", name="goal", type="cylinder", size=[0.02, _HEIGHT], pos=[0, 0, _HEIGHT], rgba=_GREEN, **_VISUAL)
    for number in range(4):
        colour = _MARK if number == 0 else _GREEN  # the first is the marked side, ahead of the others
        goal.add(
            "geom", name=f"outline{number}", type="box", size=[_LINE] * 3, pos=[0, 0, 1e-3], rgba=colour, **_VISUAL
        )


def write_looks(model: Any, half_size: float, *, pose: bool) -> None:
    """Fit the marks on box and goal, which only pictures have, to the size of the box.

    The painted face of the box is the one along its x axis. The outline around the goal is a square that the box just
    fills, with a wide yellow line on the side of that face.

    Args:
        model: ``mujoco.MjModel`` of :func:`push_scene` with its looks, changed in place.
        half_size: half edge length of the box [m].
        pose: whether the goal is a pose; a position has no outline.
    """
    reach = half_size + _LINE
    sides = ((1, 0), (0, 1), (-1, 0), (0, -1))
    for number, (x, y) in enumerate(sides):
        wide = 2 * _LINE if number == 0 else _LINE
        out = half_size + wide
        line = model.geom(f"outline{number}")
        line.pos[:] = x * out, y * out, _HEIGHT * (2 if number == 0 else 1.5)
        line.size[:] = (wide, reach + _LINE, _HEIGHT) if x else (reach + _LINE, wide, _HEIGHT)
        line.rgba[3] = float(pose)
    face, edge = model.geom("box_face"), model.geom("box_edge")
    face.pos[:], face.size[:] = (half_size, 0, 0), (_PAINT, 0.86 * half_size, 0.86 * half_size)
    edge.pos[:] = 0.74 * half_size, 0, half_size
    edge.size[:] = 0.12 * half_size, 0.86 * half_size, _PAINT


def _add_box(root: Any, half_size: float, mass: float, movable_com: bool) -> None:
    body = root.worldbody.add("body", name=PUSH_BOX, pos=[0.45, 0, half_size])
    if movable_com:  # MuJoCo compiles a body whose frame is that of its inertia into one that has to stay so
        inertia = mass * (2 * half_size) ** 2 / 6
        body.add("inertial", pos=[1e-3, 0, 0], mass=mass, diaginertia=[inertia] * 3)
    body.add("freejoint", name=PUSH_BOX)
    # With its priority, the box's friction applies to its contacts with tool and table: one number randomises both.
    body.add(
        "geom", name=PUSH_BOX, type="box", size=[half_size] * 3, mass=mass, rgba=_BOX,
        contype=0, conaffinity=5, priority=1, condim=3, friction=[0.4, 0.005, 0.0001],
    )  # fmt: skip
    for name in ("box_face", "box_edge"):
        body.add("geom", name=name, type="box", size=[1e-3] * 3, pos=[1e-3, 0, 0], rgba=_MARK, **_VISUAL)
    # The frame of the body, not that of its inertia, which an environment may move.
    root.sensor.add("framepos", name="box_position", objtype="xbody", objname=PUSH_BOX)
    root.sensor.add("framequat", name="box_orientation", objtype="xbody", objname=PUSH_BOX)


def push_scene(
    arm: Arm,
    tool: Tool = PADDLE,
    *,
    half_size: float = 0.03,
    mass: float = 0.05,
    physics_dt: float = 0.0005,
    movable_com: bool = False,
) -> Any:
    """MJCF of the pushing scene: :func:`table_scene` with a box and a goal mark.

    Args:
        arm: the arm.
        tool: the pushing tool.
        half_size: half edge length of the box [m].
        mass: mass of the box [kg].
        physics_dt: time step of the physics [s].
        movable_com: whether the box's centre of mass may be moved in the compiled model; it is 1 mm off at first.

    Returns:
        A ``dm_control.mjcf.RootElement``.
    """
    root = table_scene(arm, tool, physics_dt=physics_dt)
    _add_goal(root.worldbody)
    _add_box(root, half_size, mass, movable_com)
    return root
