"""MJCF of a table with an arm on it, lights and cameras."""

from __future__ import annotations

import math
from typing import Any

from ppt_rl.arms import Arm
from ppt_rl.envs.models.arm import PADDLE, Tool, arm_model, attach_tool

__all__ = ["table_scene"]


#: Directions of the lights that share one soft shadow [-], and how bright they are together [-].
_SPREAD = ((0.0, 0.036), (-0.031, -0.018), (0.031, -0.018))
_KEY_LIGHTS = tuple((0.10 + dx, 0.30 + dy, -1.0) for dx, dy in _SPREAD)
_KEY_LIGHT, _FILL_LIGHT = 0.40, 0.30


def _add_looks(root: Any) -> None:
    visual = root.visual
    visual.headlight.ambient, visual.headlight.diffuse = [0.33, 0.33, 0.34], [0.12, 0.12, 0.12]
    visual.headlight.specular = [0.05, 0.05, 0.05]
    visual.quality.shadowsize, visual.quality.offsamples = 2048, 4
    visual.map.shadowclip = 0.6
    root.statistic.extent, root.statistic.center = 1.5, [0.4, 0.0, 0.2]
    getattr(visual, "global").offwidth, getattr(visual, "global").offheight = 1280, 960
    root.asset.add(
        "texture", name="sky", type="skybox", builtin="gradient", rgb1=[0.60, 0.70, 0.82], rgb2=[0.95, 0.96, 0.98],
        width=64, height=384,
    )  # fmt: skip
    root.asset.add(
        "texture", name="tiles", type="2d", builtin="checker", rgb1=[0.58, 0.61, 0.65], rgb2=[0.54, 0.57, 0.61],
        mark="edge", markrgb=[0.66, 0.69, 0.73], width=256, height=256,
    )  # fmt: skip
    root.asset.add("material", name="tiles", texture="tiles", texrepeat=[3, 3], texuniform=True, reflectance=0.0)
    root.asset.add("material", name="wood", rgba=[0.80, 0.74, 0.64, 1], specular=0.15, shininess=0.3)
    for number, direction in enumerate(_KEY_LIGHTS):  # a shadow of each: where only some fall, it is half dark
        share = _KEY_LIGHT / len(_KEY_LIGHTS)
        root.worldbody.add(
            "light", name=f"key{number}", type="directional", pos=[0.25, -0.5, 1.5], dir=direction,
            diffuse=[share] * 3, specular=[0.5 * share] * 3, castshadow=True,
        )  # fmt: skip
    root.worldbody.add(
        "light", name="fill", type="directional", pos=[2.0, 1.0, 1.5], dir=[-0.8, -0.5, -0.5],
        diffuse=[_FILL_LIGHT] * 3, specular=[0.0] * 3, castshadow=False,
    )  # fmt: skip


def _add_table(world: Any) -> None:
    # Contacts are with a plane, since box against plane costs half as much as box against box. The slab is for looks.
    world.add("geom", name="table", type="plane", size=[0.55, 0.45, 0.1], contype=4, conaffinity=0, group=4)
    world.add(
        "geom", name="slab", type="box", pos=[0.35, 0, -0.0201], size=[0.55, 0.45, 0.02], material="wood",
        contype=0, conaffinity=0, group=2,
    )  # fmt: skip
    world.add(
        "geom", name="ground", type="plane", pos=[0, 0, -0.6], size=[0, 0, 0.1], material="tiles",
        contype=0, conaffinity=0, group=2,
    )  # fmt: skip
    for x in (-0.15, 0.85):
        for y in (-0.40, 0.40):
            world.add(
                "geom", type="box", pos=[x, y, -0.32], size=[0.025, 0.025, 0.28], rgba=[0.30, 0.31, 0.33, 1],
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
    for name, eye, target, fovy in _CAMERAS:
        world.add("camera", name=name, pos=eye, xyaxes=_look_at(eye, target), fovy=fovy)
    world.add("camera", name="top", pos=[0.55, 0.0, 1.0], xyaxes=[0, -1, 0, 1, 0, 0], fovy=40)
    return root


#: Name, place, what is in the middle of the picture [m], and the vertical angle of view [degrees].
_CAMERAS = (
    ("overview", (1.45, -0.95, 0.72), (0.36, -0.01, 0.25), 37),
    ("close", (1.15, -0.62, 0.55), (0.54, 0.0, 0.06), 32),
    ("side", (0.5, -1.3, 0.3), (0.42, 0.0, 0.2), 40),
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
