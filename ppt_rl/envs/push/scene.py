"""The pushing scene: a box and a goal mark on the table."""

from __future__ import annotations

from typing import Any

from ppt_rl.arms import Arm
from ppt_rl.envs.models import PADDLE, Tool, table_scene

__all__ = ["PUSH_BOX", "push_scene"]

#: Name of the box's body, joint and geom.
PUSH_BOX = "box"


def _add_goal(world: Any) -> None:
    goal = world.add("body", name="goal", pos=[0.65, 0, 0])
    goal.add(
        "geom", name="goal", type="cylinder", size=[0.02, 0.0005], pos=[0, 0, 0.0006], rgba=[0.13, 0.65, 0.30, 0.9],
        contype=0, conaffinity=0, group=2,
    )  # fmt: skip
    for sx in (-1, 1):
        for sy in (-1, 1):
            goal.add(
                "geom", type="box", size=[0.012, 0.0015, 0.0004], pos=[sx * 0.042, sy * 0.054, 0.0005],
                rgba=[0.13, 0.65, 0.30, 0.9], contype=0, conaffinity=0, group=2,
            )  # fmt: skip


def _add_box(root: Any, half_size: float, mass: float, movable_com: bool) -> None:
    body = root.worldbody.add("body", name=PUSH_BOX, pos=[0.45, 0, half_size])
    if movable_com:  # MuJoCo compiles a body whose frame is that of its inertia into one that has to stay so
        inertia = mass * (2 * half_size) ** 2 / 6
        body.add("inertial", pos=[1e-3, 0, 0], mass=mass, diaginertia=[inertia] * 3)
    body.add("freejoint", name=PUSH_BOX)
    # With its priority, the box's friction applies to its contacts with tool and table: one number randomises both.
    body.add(
        "geom", name=PUSH_BOX, type="box", size=[half_size] * 3, mass=mass, rgba=[0.86, 0.45, 0.20, 1],
        contype=0, conaffinity=5, priority=1, condim=3, friction=[0.4, 0.005, 0.0001],
    )  # fmt: skip
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
