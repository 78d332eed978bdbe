"""The Panda arm from its Denavit-Hartenberg table, with primitive shapes for looks, and the tools on its flange."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from ppt_rl.arms.panda import DH, FLANGE, INERTIAL, JOINT_LIMITS, TORQUE_LIMITS
from ppt_rl.envs.mujoco_imports import mjcf

__all__ = ["CYLINDER", "PADDLE", "Tool", "attach_tool", "panda_model", "remove_visual_geoms"]

#: Reflected rotor inertia of a joint [kg m^2]: the order of the Panda's drives; it keeps the wrist calm at 100 Hz.
ARMATURE = 0.1
_WHITE = (0.93, 0.93, 0.92, 1.0)
_GREY = (0.32, 0.34, 0.37, 1.0)
_TOOL = (0.16, 0.42, 0.74, 1.0)
#: Density of printed PLA [kg/m^3].
_PLA = 1240.0


@dataclass(frozen=True)
class Tool:
    """A rigid tool: a stem along the flange axis, which ends in a cross-bar or by itself.

    Attributes:
        length: flange to end-effector point, the centre of the bar or of the stem's end [m].
        stem_radius: [m].
        bar: size of the bar across, along and up the tool's x, y, z axes [m]; None for a stem alone.
    """

    length: float
    stem_radius: float
    bar: tuple[float, float, float] | None = None

    @property
    def half_thickness(self) -> float:
        """From the tool's axis to its face along x [m]."""
        return self.stem_radius if self.bar is None else 0.5 * self.bar[0]


#: The paddle of the pushing task: 12 x 1 x 1 cm, the long side along the tool's y axis (paper, fig. 5).
PADDLE = Tool(length=0.16, stem_radius=0.006, bar=(0.01, 0.12, 0.01))
#: The cylinder of the maze task: 12 cm long, 2.5 cm thick (paper, fig. 5).
CYLINDER = Tool(length=0.12, stem_radius=0.0125)

#: Shells of the links: (body, shape, colour, radius, from, to), all in link frames [m]. Only for looks.
_SHELLS: tuple[tuple[int, str, tuple[float, ...], float, tuple[float, ...], tuple[float, ...]], ...] = (
    (0, "cylinder", _WHITE, 0.078, (0.0, 0.0, 0.0), (0.0, 0.0, 0.05)),
    (0, "capsule", _WHITE, 0.062, (-0.06, 0.0, 0.035), (0.0, 0.0, 0.05)),
    (0, "cylinder", _WHITE, 0.060, (0.0, 0.0, 0.05), (0.0, 0.0, 0.14)),
    (1, "cylinder", _GREY, 0.0585, (0.0, 0.0, -0.193), (0.0, 0.0, -0.185)),
    (1, "cylinder", _WHITE, 0.060, (0.0, 0.0, -0.185), (0.0, 0.0, -0.06)),
    (1, "capsule", _WHITE, 0.060, (0.0, 0.0, -0.07), (0.0, 0.0, -0.01)),
    (1, "cylinder", _WHITE, 0.057, (0.0, -0.075, 0.0), (0.0, 0.02, 0.0)),
    (2, "cylinder", _GREY, 0.054, (0.0, 0.0, 0.075), (0.0, 0.0, 0.083)),
    (2, "cylinder", _WHITE, 0.057, (0.0, 0.0, -0.02), (0.0, 0.0, 0.075)),
    (2, "capsule", _WHITE, 0.058, (0.0, -0.03, 0.0), (0.0, -0.14, 0.0)),
    (2, "cylinder", _WHITE, 0.056, (0.0, -0.12, 0.0), (0.0, -0.19, 0.0)),
    (3, "cylinder", _GREY, 0.0535, (0.0, 0.0, -0.126), (0.0, 0.0, -0.119)),
    (3, "cylinder", _WHITE, 0.055, (0.0, 0.0, -0.119), (0.0, 0.0, -0.06)),
    (3, "capsule", _WHITE, 0.055, (0.0, 0.0, -0.065), (0.0825, 0.0, 0.0)),
    (3, "cylinder", _WHITE, 0.050, (0.0825, -0.065, 0.0), (0.0825, 0.02, 0.0)),
    (4, "cylinder", _GREY, 0.047, (0.0, 0.0, 0.065), (0.0, 0.0, 0.073)),
    (4, "cylinder", _WHITE, 0.050, (0.0, 0.0, -0.02), (0.0, 0.0, 0.065)),
    (4, "capsule", _WHITE, 0.053, (0.0, 0.0, 0.0), (-0.0825, 0.075, 0.0)),
    (4, "cylinder", _WHITE, 0.052, (-0.0825, 0.07, 0.0), (-0.0825, 0.115, 0.0)),
    (5, "cylinder", _GREY, 0.0505, (0.0, 0.0, -0.269), (0.0, 0.0, -0.262)),
    (5, "cylinder", _WHITE, 0.052, (0.0, 0.0, -0.262), (0.0, 0.0, -0.19)),
    (5, "capsule", _WHITE, 0.046, (0.0, 0.02, -0.195), (0.0, 0.062, -0.09)),
    (5, "capsule", _WHITE, 0.042, (0.0, 0.062, -0.09), (0.0, 0.062, -0.005)),
    (5, "cylinder", _WHITE, 0.047, (0.0, 0.085, 0.0), (0.0, 0.015, 0.0)),
    (6, "cylinder", _GREY, 0.045, (0.0, 0.0, -0.020), (0.0, 0.0, -0.013)),
    (6, "cylinder", _WHITE, 0.048, (0.0, 0.0, -0.013), (0.0, 0.0, 0.050)),
    (6, "capsule", _WHITE, 0.044, (0.0, 0.0, 0.015), (0.088, 0.0, 0.01)),
    (6, "cylinder", _WHITE, 0.046, (0.088, -0.045, 0.0), (0.088, 0.04, 0.0)),
    (7, "cylinder", _GREY, 0.043, (0.0, 0.0, 0.046), (0.0, 0.0, 0.052)),
    (7, "cylinder", _WHITE, 0.044, (0.0, 0.0, 0.052), (0.0, 0.0, 0.085)),
    (7, "cylinder", _GREY, 0.032, (0.0, 0.0, 0.085), (0.0, 0.0, 0.107)),
)


def _add_shells(body: Any, index: int) -> None:
    for link, shape, colour, radius, start, end in _SHELLS:
        if link == index:
            body.add(
                "geom", type=shape, size=[radius], fromto=[*start, *end], rgba=colour,
                contype=0, conaffinity=0, group=2, mass=0,
            )  # fmt: skip


def panda_model() -> Any:
    """MJCF of the arm: seven hinges, motors, gravity compensation, joint sensors. It carries no collision geometry.

    Returns:
        A ``dm_control.mjcf.RootElement``; the flange is the body ``link7``.
    """
    root = mjcf.RootElement(model="panda")
    root.compiler.angle = "radian"
    parent = root.worldbody.add("body", name="link0", gravcomp=1)
    _add_shells(parent, 0)
    for i, (a, d, alpha) in enumerate(DH, start=1):
        parent = parent.add(
            "body",
            name=f"link{i}",
            pos=[a, -math.sin(alpha) * d, math.cos(alpha) * d],
            quat=[math.cos(alpha / 2), math.sin(alpha / 2), 0, 0],
            gravcomp=1,
        )
        link = INERTIAL[i - 1]
        parent.add("inertial", pos=link.com, mass=link.mass, fullinertia=link.inertia)
        joint = parent.add(
            "joint", name=f"joint{i}", type="hinge", axis=[0, 0, 1], range=JOINT_LIMITS[i - 1], limited=True,
            armature=ARMATURE,
        )  # fmt: skip
        _add_shells(parent, i)
        limit = TORQUE_LIMITS[i - 1]
        root.actuator.add("motor", name=f"motor{i}", joint=joint, ctrllimited=True, ctrlrange=[-limit, limit])
    # All positions before all velocities: each quantity is one contiguous slice of the sensor vector.
    for kind, quantity in (("jointpos", "joint_position"), ("jointvel", "joint_velocity")):
        for i in range(1, len(DH) + 1):
            root.sensor.add(kind, name=f"{quantity}{i}", joint=f"joint{i}")
    return root


def remove_visual_geoms(root: Any) -> None:
    """Drop every geom that cannot collide: a quarter of the physics' time goes into moving them along.

    Args:
        root: the model, changed in place.
    """
    for geom in root.find_all("geom"):
        if geom.contype == 0 and geom.conaffinity == 0:
            geom.remove()


def attach_tool(root: Any, tool: Tool) -> Any:
    """Put ``tool`` on the flange of :func:`panda_model`, with its frame and sensors.

    The site ``end_effector`` is the end-effector point, z along the flange axis. Pose and twist are in world axes; the
    force and torque sensors give what the arm applies to the tool, in the site's axes (the environment turns them to
    world axes and takes the tool's weight off).

    Args:
        root: the arm.
        tool: the tool.

    Returns:
        The tool's body element.
    """
    length, turn = FLANGE
    body = root.find("body", "link7").add(
        "body", name="tool", pos=[0, 0, length], quat=[math.cos(turn / 2), 0, 0, math.sin(turn / 2)], gravcomp=1
    )
    common: dict[str, Any] = {"rgba": _TOOL, "density": _PLA, "contype": 1, "conaffinity": 0, "group": 1}
    stem_end = tool.length - (0.0 if tool.bar is None else 0.5 * tool.bar[2])
    body.add("geom", name="stem", type="cylinder", size=[tool.stem_radius], fromto=[0, 0, 0, 0, 0, stem_end], **common)
    if tool.bar is not None:
        half = [0.5 * side for side in tool.bar]
        body.add("geom", name="bar", type="box", size=half, pos=[0, 0, tool.length], **common)
    site = body.add("site", name="end_effector", pos=[0, 0, tool.length], size=[0.004], group=4)
    sensor = root.sensor
    sensor.add("framepos", name="position", objtype="site", objname=site)
    sensor.add("framequat", name="orientation", objtype="site", objname=site)
    sensor.add("framelinvel", name="linear_velocity", objtype="site", objname=site)
    sensor.add("frameangvel", name="angular_velocity", objtype="site", objname=site)
    sensor.add("force", name="force", site=site)
    sensor.add("torque", name="torque", site=site)
    return body
