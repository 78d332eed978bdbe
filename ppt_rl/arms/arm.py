"""What the library knows of an arm: kinematics, limits, inertia and looks, as plain numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any, NamedTuple

from ppt_rl.arms.chain import Chain, DHRow, Vector3

__all__ = ["Arm", "Inertial", "Joints", "Limits", "Shell"]


#: Shapes of a shell.
_SHAPES = ("cylinder", "tube")


class Limits(NamedTuple):
    """A closed interval.

    Attributes:
        low: lower end.
        high: upper end.
    """

    low: float
    high: float


class Inertial(NamedTuple):
    """Inertial parameters of a link, in the frame of its joint.

    Attributes:
        mass: [kg].
        com: centre of mass [m].
        inertia: ixx, iyy, izz, ixy, ixz, iyz about the centre of mass [kg m^2].
    """

    mass: float
    com: Vector3
    inertia: tuple[float, float, float, float, float, float]

    def in_joint_frame(self, row: DHRow) -> Inertial:
        """Convert parameters that are given in the frame of a standard Denavit-Hartenberg table.

        Args:
            row: the link's row, whose fixed part ``Tz(d) Tx(a) Rx(alpha)`` leads from the joint's frame to the table's.

        Returns:
            The parameters in the joint's frame.
        """
        c, s = math.cos(row.alpha), math.sin(row.alpha)
        x, y, z = self.com
        xx, yy, zz, xy, xz, yz = self.inertia
        turned = (
            xx,
            c * c * yy - 2 * c * s * yz + s * s * zz,
            s * s * yy + 2 * c * s * yz + c * c * zz,
            c * xy - s * xz,
            s * xy + c * xz,
            c * s * (yy - zz) + (c * c - s * s) * yz,
        )
        return Inertial(self.mass, (x + row.a, c * y - s * z, s * y + c * z + row.d), turned)


@dataclass(frozen=True)
class Joints:
    """Limits and inertia of the joints; each table has one entry for each joint.

    Attributes:
        position_limits: [rad].
        velocity_limits: largest speed [rad/s].
        torque_limits: largest torque [N m].
        armature: inertia of the rotor, reflected through the gear to the joint [kg m^2].
        inertia: diagonal of the joint-space inertia matrix, armature included; medians over the workspace of the
            pushing task, printed by ``benchmarks/apparent_inertia.py`` [kg m^2].

    Raises:
        ValueError: if the tables differ in length or a number is impossible.
    """

    position_limits: tuple[Limits, ...]
    velocity_limits: tuple[float, ...]
    torque_limits: tuple[float, ...]
    armature: tuple[float, ...]
    inertia: tuple[float, ...]

    def __post_init__(self) -> None:
        """Refuse tables that differ in length and numbers that no joint has."""
        for name, values in vars(self).items():
            if not isinstance(values, Sequence) or isinstance(values, str):
                raise ValueError(f"{name} is {values!r}; expected a tuple with one entry for each joint.")
        lengths = {name: len(values) for name, values in vars(self).items()}
        if len(set(lengths.values())) != 1:
            raise ValueError(f"the tables of the joints have the lengths {lengths}; expected one entry for each joint.")
        for index, limits in enumerate(self.position_limits, start=1):
            if not _is_interval(limits):
                shown = tuple(limits) if isinstance(limits, tuple) else limits
                raise ValueError(f"position_limits of joint {index} are {shown}; expected low < high [rad].")
        for name in ("velocity_limits", "torque_limits", "inertia"):
            _require_positive(name, getattr(self, name))
        if not all(isinstance(value, Real) and 0 <= value < math.inf for value in self.armature):
            raise ValueError(f"armature is {self.armature}; expected numbers of at least 0 kg m^2.")


class Shell(NamedTuple):
    """A shape that shows what a link looks like. It has no mass and touches nothing.

    Attributes:
        link: index of the link that carries it; 0 is the base.
        shape: ``"cylinder"``, whose edges are rounded, or ``"tube"``, straight or bent, with half a ball at each end.
        colour: red, green, blue and opacity, each in [0, 1].
        radius: [m]; of a tube, at its start.
        start: centre of one end, in the link's frame [m].
        end: centre of the other end [m].
        edge: radius of the rounded edges of a cylinder [m].
        via: what a tube bends towards, the middle control point of a quadratic Bézier curve [m]; None: it is straight.
        end_radius: radius of a tube at its end [m]; None: that at its start.
    """

    link: int
    shape: str
    colour: tuple[float, float, float, float]
    radius: float
    start: Vector3
    end: Vector3
    edge: float = 0.006
    via: Vector3 | None = None
    end_radius: float | None = None


@dataclass(frozen=True)
class Arm:
    """A serial arm with revolute joints, its base at the origin of the world and its z axis up.

    Attributes:
        name: short name, by which :func:`ppt_rl.arms.find_arm` finds it.
        chain: kinematic chain from base to tool.
        joints: limits and inertia of the joints.
        links: inertial parameters of the links that move.
        home: joint position with the tool in front of the base and pointing down: the first guess of inverse kinematics
            and the posture of redundant arms [rad].
        reach: distances from the base's axis within which mazes are built; at the table's height, an upright tool must
            reach all of them [m].
        apparent_inertia: inertia of the end effector along the world's x, y and z axes and about them, from which the
            impedance's damping follows; medians like those of :attr:`Joints.inertia` [kg, kg m^2].
        shells: what the arm looks like.

    Raises:
        ValueError: if the parts describe different numbers of joints or a number is impossible.
    """

    name: str
    chain: Chain
    joints: Joints
    links: tuple[Inertial, ...]
    home: tuple[float, ...]
    reach: Limits
    apparent_inertia: tuple[float, float, float, float, float, float]
    shells: tuple[Shell, ...] = ()

    @property
    def num_joints(self) -> int:
        """How many joints the arm has."""
        return len(self.chain.offsets)

    def __post_init__(self) -> None:
        """Refuse parts that do not fit together."""
        if not isinstance(self.name, str) or not self.name:
            raise ValueError(f"name is {self.name!r}; expected a short text, such as 'panda'.")
        for part, kind in (("chain", Chain), ("joints", Joints)):
            if not isinstance(getattr(self, part), kind):
                raise ValueError(f"{part} is {getattr(self, part)!r}; expected a {kind.__name__}.")
        count = self.num_joints
        lengths = {"joints": len(self.joints.torque_limits), "links": len(self.links), "home": len(self.home)}
        if not count or set(lengths.values()) != {count}:
            raise ValueError(f"{self.name} has a chain of {count} joints, but {lengths}; expected {count} of each.")
        for index, (angle, (low, high)) in enumerate(zip(self.home, self.joints.position_limits, strict=True), start=1):
            if not low <= angle <= high:
                raise ValueError(f"home of joint {index} is {angle} rad; expected {low} to {high} rad, its limits.")
        _require_positive("mass of the links", [link.mass for link in self.links])
        _require_positive("diagonal inertia of the links", [value for link in self.links for value in link.inertia[:3]])
        for index, link in enumerate(self.links, start=1):
            if not all(isinstance(value, Real) and math.isfinite(value) for value in (*link.com, *link.inertia)):
                raise ValueError(f"link {index} is {link}; expected finite numbers for its com and inertia.")
        _require_positive("apparent_inertia", self.apparent_inertia)
        if len(self.apparent_inertia) != 6:
            raise ValueError(f"apparent_inertia is {self.apparent_inertia}; expected six numbers [kg, kg m^2].")
        if not _is_interval(self.reach) or self.reach[0] <= 0:
            shown = tuple(self.reach) if isinstance(self.reach, tuple) else self.reach
            raise ValueError(f"reach is {shown}; expected 0 < low < high [m].")
        self._check_shells()

    def _check_shells(self) -> None:
        count = self.num_joints
        unknown = sorted({shell.link for shell in self.shells if not 0 <= shell.link <= count})
        if unknown:
            raise ValueError(f"shells belong to the links {unknown}; expected 0 (the base) to {count}.")
        for shell in self.shells:
            if shell.shape not in _SHAPES:
                raise ValueError(f"the shape of a shell is {shell.shape!r}; expected one of {_SHAPES}.")
            _require_positive("radius of the shells", [shell.radius, shell.edge, shell.end_radius or shell.radius])
            if tuple(shell.start) == tuple(shell.end):
                raise ValueError(f"a shell of link {shell.link} starts and ends at {shell.start}; expected two points.")


def _is_interval(limits: Any) -> bool:
    """Whether these are two finite numbers, the first below the second."""
    numbers = isinstance(limits, Sequence) and len(limits) == 2 and all(isinstance(end, Real) for end in limits)
    return numbers and -math.inf < limits[0] < limits[1] < math.inf


def _require_positive(name: str, values: Sequence[float]) -> None:
    if not all(isinstance(value, Real) and 0 < value < math.inf for value in values):
        raise ValueError(f"{name}: {tuple(values)}; expected finite numbers above 0.")
