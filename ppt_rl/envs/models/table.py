"""MJCF of a table with an arm on it, lights and cameras."""

from __future__ import annotations

import math
from typing import Any

from ppt_rl.arms import Arm
from ppt_rl.envs.models.arm import PADDLE, Tool, arm_model, attach_tool

__all__ = ["table_scene"]


def _add_looks(root: Any) -> None:
    visual = root.visual
    visual.headlight.ambient, visual.headlight.diffuse = [0.33, 0.33, 0.33], [0.18, 0.18, 0.18]
    visual.headlight.specular = [0.1, 0.1, 0.1]
    visual.quality.shadowsize, visual.quality.offsamples = 2048, 4
    getattr(visual, "global").offwidth, getattr(visual, "global").offheight = 1280, 960
    root.asset.add(
        "texture", name="sky", type="skybox", builtin="gradient", rgb1=[0.82, 0.87, 0.92], rgb2=[0.97, 0.97, 0.98],
        width=64, height=384,
    )  # fmt: skip
    root.worldbody.add(
        "light",
        pos=[0.3, -0.6, 1.8],
        dir=[0.1, 0.35, -1],
        diffuse=[0.5, 0.5, 0.5],
        castshadow=True,
        type="directional",
    )


def _add_table(world: Any) -> None:
    # Contacts are with a plane, since box against plane costs half as much as box against box. The slab is for looks.
    world.add("geom", name="table", type="plane", size=[0.55, 0.45, 0.1], contype=4, conaffinity=0, group=4)
    world.add(
        "geom", name="slab", type="box", pos=[0.35, 0, -0.0201], size=[0.55, 0.45, 0.02], rgba=[0.80, 0.76, 0.69, 1],
        contype=0, conaffinity=0, group=2,
    )  # fmt: skip
    world.add(
        "geom", name="ground", type="plane", pos=[0, 0, -0.6], size=[3, 3, 0.1], rgba=[0.62, 0.64, 0.66, 1],
        contype=0, conaffinity=0, group=2,
    )  # fmt: skip
    for x in (-0.15, 0.85):
        for y in (-0.40, 0.40):
            world.add(
                "geom", type="box", pos=[x, y, -0.32], size=[0.025, 0.025, 0.28], rgba=[0.45, 0.45, 0.46, 1],
                contype=0, conaffinity=0, group=2,
            )  # fmt: skip


def table_scene(arm: Arm, tool: Tool = PADDLE, *, physics_dt: float = 0.0005) -> Any:
    """Build the MJCF of an arm with a tool over an empty table, whose top is z = 0.

    Args:
        arm: the arm; its base stands on the table, at the origin.
        tool: the tool on the flange.
        physics_dt: time step of the physics [s].

    Returns:
        A ``dm_control.mjcf.RootElement``.
    """
    root = arm_model(arm)
    root.option.timestep = physics_dt
    # An implicit integrator gains nothing without joint damping, and Euler is faster.
    root.option.integrator = "Euler"
    # A pyramidal cone's friction points along an axis of the contact frame rather than against the motion, and so
    # carries a pushed box 4 cm sideways.
    root.option.cone = "elliptic"
    _add_looks(root)
    world = root.worldbody
    _add_table(world)
    attach_tool(root, arm, tool)
    for name, eye, target in _CAMERAS:
        world.add("camera", name=name, pos=eye, xyaxes=_look_at(eye, target))
    world.add("camera", name="top", pos=[0.55, 0.0, 1.0], xyaxes=[0, -1, 0, 1, 0, 0], fovy=40)
    return root


_CAMERAS = (
    ("overview", (1.45, -0.95, 0.85), (0.38, 0.0, 0.2)),
    ("side", (0.5, -1.3, 0.3), (0.45, 0.0, 0.15)),
)


def _look_at(eye: tuple[float, float, float], target: tuple[float, float, float]) -> list[float]:
    """The ``xyaxes`` of a camera at ``eye`` that looks at ``target``, with z up."""
    forward = [t - e for t, e in zip(target, eye, strict=True)]
    right = [forward[1], -forward[0], 0.0]
    up = [
        right[1] * forward[2],
        -right[0] * forward[2],
        right[0] * forward[1] - right[1] * forward[0],
    ]

    def unit(v: list[float]) -> list[float]:
        norm = math.sqrt(sum(x * x for x in v))
        return [x / norm for x in v]

    return unit(right) + unit(up)
