"""MJCF of an arm with its shells, and of the tool on its flange."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from ppt_rl.arms import Arm
from ppt_rl.envs.models.shapes import shell_mesh
from ppt_rl.envs.mujoco_imports import mjcf
from ppt_rl.functional.argument_checks import require_numbers
from ppt_rl.functional.checks import require_positive

__all__ = ["CYLINDER", "PADDLE", "Tool", "arm_model", "attach_tool", "remove_looks"]

#: Colours of the tool, and of what joins it to the flange and shows the end-effector point.
_TOOL, _BRIGHT = (0.13, 0.36, 0.68, 1.0), (0.93, 0.94, 0.95, 1.0)
#: By how much the ball at the end-effector point is larger than the tool there needs it to be [m].
_TIP = 0.005
#: Density of printed PLA [kg/m^3].
_PLA = 1240.0


@dataclass(frozen=True)
class Tool:
    """A rigid tool: a stem along the flange's axis, with or without a crossbar at its end.

    Attributes:
        length: distance from the flange to the end-effector point, the centre of the bar or of the stem's end [m].
        stem_radius: radius of the stem [m].
        bar: size of the bar along the tool's x, y and z axes [m]; None for a stem alone.

    Raises:
        ValueError: if a size is not positive, or the bar has not three of them.
    """

    length: float
    stem_radius: float
    bar: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        """Check the sizes."""
        require_positive("Tool.length", self.length, "m")
        require_positive("Tool.stem_radius", self.stem_radius, "m")
        if self.bar is not None:
            require_numbers("Tool.bar", self.bar, (3,), unit="m")
            for side in self.bar:
                require_positive("a side of Tool.bar", side, "m")

    @property
    def half_extent(self) -> tuple[float, float, float]:
        """Half size of the tool's end along its axes: of the bar, or of the stem [m]."""
        if self.bar is None:
            return self.stem_radius, self.stem_radius, 0.0
        return 0.5 * self.bar[0], 0.5 * self.bar[1], 0.5 * self.bar[2]

    @property
    def half_thickness(self) -> float:
        """Distance from the tool's axis to its face along x [m]."""
        return self.stem_radius if self.bar is None else 0.5 * self.bar[0]


#: The paddle of the pushing task: 12 x 1 x 1 cm, the long side along the tool's y axis (paper, fig. 5).
PADDLE = Tool(length=0.16, stem_radius=0.006, bar=(0.01, 0.12, 0.01))
#: The cylinder of the maze task: 12 cm long, 2.5 cm thick (paper, fig. 5).
CYLINDER = Tool(length=0.12, stem_radius=0.0125)


def _add_shells(root: Any, body: Any, arm: Arm, link: int) -> None:
    for number, shell in enumerate(arm.shells):
        if shell.link == link:
            vertices, triangles = shell_mesh(shell)
            mesh = root.asset.add("mesh", name=f"shell{number}", vertex=vertices.ravel(), face=triangles.ravel())
            body.add(
                "geom", name=f"shell{number}", type="mesh", mesh=mesh, rgba=shell.colour, contype=0, conaffinity=0,
                group=2, mass=0,
            )  # fmt: skip


def arm_model(arm: Arm) -> Any:
    """Build the MJCF of an arm with hinges, motors, joint sensors and gravity compensation, but no collision geometry.

    Args:
        arm: the arm.

    Returns:
        A ``dm_control.mjcf.RootElement``. Its bodies are ``link1`` to ``link{n}`` (which carries the flange); the base
        does not move, so it belongs to the world. Joints ``joint{i}``, motors ``motor{i}`` and sensors
        ``joint_position{i}`` and ``joint_velocity{i}`` are counted from 1.
    """
    root = mjcf.RootElement(model=arm.name)
    root.compiler.angle = "radian"
    parent = root.worldbody
    _add_shells(root, parent, arm, 0)
    for i, (offset, link) in enumerate(zip(arm.chain.offsets, arm.links, strict=True), start=1):
        parent = parent.add(
            "body", name=f"link{i}", pos=offset.position, quat=_orientation(offset.twist, offset.turn), gravcomp=1
        )
        parent.add("inertial", pos=link.com, mass=link.mass, fullinertia=link.inertia)
        joint = parent.add(
            "joint", name=f"joint{i}", type="hinge", axis=[0, 0, 1], range=arm.joints.position_limits[i - 1],
            limited=True, armature=arm.joints.armature[i - 1],
        )  # fmt: skip
        _add_shells(root, parent, arm, i)
        limit = arm.joints.torque_limits[i - 1]
        root.actuator.add("motor", name=f"motor{i}", joint=joint, ctrllimited=True, ctrlrange=[-limit, limit])
    # All positions before all velocities: each quantity is one contiguous slice of the sensor vector.
    for kind, quantity in (("jointpos", "joint_position"), ("jointvel", "joint_velocity")):
        for i in range(1, arm.num_joints + 1):
            root.sensor.add(kind, name=f"{quantity}{i}", joint=f"joint{i}")
    return root


def _orientation(twist: float, turn: float) -> list[float]:
    """Quaternion ``(w, x, y, z)`` of ``Rx(twist) Rz(turn)``."""
    cx, sx, cz, sz = math.cos(twist / 2), math.sin(twist / 2), math.cos(turn / 2), math.sin(turn / 2)
    return [cx * cz, sx * cz, -sx * sz, cx * sz]


def remove_looks(root: Any) -> None:
    """Remove what only pictures show; what remains moves alike.

    That is every geom that cannot collide, with the meshes, materials and textures, the cameras and the lights. To move
    them along would take a quarter of the time of the physics, and every environment has a copy of the model. A camera
    that a sensor reads stays.

    Args:
        root: the model, changed in place.
    """
    for geom in root.find_all("geom"):
        if geom.contype == 0 and geom.conaffinity == 0:
            geom.remove()
    read = {id(value) for sensor in root.find_all("sensor") for value in sensor.get_attributes().values()}
    for kind in ("mesh", "material", "texture", "camera", "light"):
        for element in root.find_all(kind):
            if id(element) not in read:
                element.remove()


def attach_tool(root: Any, arm: Arm, tool: Tool) -> Any:
    """Put a tool with its sensors on the flange of an arm.

    The site ``end_effector`` marks the end-effector point; its z axis is the flange's. The sensors of pose and twist
    use world axes. The sensors of force and torque give what the arm applies to the tool, in the site's axes
    (:class:`ppt_rl.envs.readings.ArmReadings` turns them into world axes and subtracts the tool's weight).

    Args:
        root: the model of :func:`arm_model`, changed in place.
        arm: the arm.
        tool: the tool.

    Returns:
        The tool's body element.
    """
    body = root.find("body", f"link{arm.num_joints}").add(
        "body", name="tool", pos=[0, 0, arm.chain.flange], quat=_orientation(0.0, arm.chain.tool_turn), gravcomp=1
    )
    common: dict[str, Any] = {"rgba": _TOOL, "density": _PLA, "contype": 1, "conaffinity": 0, "group": 1}
    stem_end = tool.length - (0.0 if tool.bar is None else 0.5 * tool.bar[2])
    body.add("geom", name="stem", type="cylinder", size=[tool.stem_radius], fromto=[0, 0, 0, 0, 0, stem_end], **common)
    if tool.bar is not None:
        half = [0.5 * side for side in tool.bar]
        body.add("geom", name="bar", type="box", size=half, pos=[0, 0, tool.length], **common)
    visual: dict[str, Any] = {"rgba": _BRIGHT, "contype": 0, "conaffinity": 0, "group": 2, "mass": 0}
    body.add("geom", name="adapter", type="cylinder", size=[2 * tool.stem_radius, 0.004], pos=[0, 0, 0.004], **visual)
    body.add(
        "geom", name="tip", type="sphere", size=[0.4 * tool.half_thickness + _TIP], pos=[0, 0, tool.length], **visual
    )
    site = body.add("site", name="end_effector", pos=[0, 0, tool.length], size=[0.004], group=4)
    sensor = root.sensor
    sensor.add("framepos", name="position", objtype="site", objname=site)
    sensor.add("framequat", name="orientation", objtype="site", objname=site)
    sensor.add("framelinvel", name="linear_velocity", objtype="site", objname=site)
    sensor.add("frameangvel", name="angular_velocity", objtype="site", objname=site)
    sensor.add("force", name="force", site=site)
    sensor.add("torque", name="torque", site=site)
    return body
