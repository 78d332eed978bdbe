"""What the library knows of an arm: geometry, limits, inertia and looks, as plain numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

__all__ = ["Arm", "Chain", "DHRow", "Inertial", "Joints", "Limits", "Offset", "Shell"]

Vector3 = tuple[float, float, float]


class Limits(NamedTuple):
    """A closed interval.

    Attributes:
        low: lower end.
        high: upper end.
    """

    low: float
    high: float


class DHRow(NamedTuple):
    """One row of a Denavit-Hartenberg table.

    Attributes:
        a: length along x [m].
        d: offset along z [m].
        alpha: rotation about x [rad].
        theta: joint angle at which the joint's position is zero [rad].
    """

    a: float
    d: float
    alpha: float
    theta: float = 0.0


class Offset(NamedTuple):
    """Fixed pose of a joint's frame in the frame of the link before it; the joint then turns about its z axis.

    The rotation is ``Rx(twist) Rz(turn)``.

    Attributes:
        position: [m].
        twist: rotation about x [rad].
        turn: rotation about z that follows [rad].
    """

    position: Vector3
    twist: float
    turn: float = 0.0


@dataclass(frozen=True)
class Chain:
    """Kinematic chain of revolute joints, each a fixed offset followed by a rotation about z.

    Link ``i`` carries the frame of joint ``i``, and the flange lies on the axis of the last joint.

    Attributes:
        offsets: one for each joint, from the base outwards.
        flange: distance from the last joint's frame to the flange along its z axis [m].
    """

    offsets: tuple[Offset, ...]
    flange: float

    @classmethod
    def modified_dh(cls, rows: Sequence[DHRow], *, flange: float) -> Chain:
        """The chain of a modified (Craig) table: ``T_i = Rx(alpha) Tx(a) Rz(q + theta) Tz(d)``.

        Args:
            rows: one for each joint.
            flange: distance from the last joint's frame to the flange along its z axis [m].

        Returns:
            The chain; its link frames are the frames of the table.
        """
        offsets = [
            Offset((row.a, -math.sin(row.alpha) * row.d, math.cos(row.alpha) * row.d), row.alpha, row.theta)
            for row in rows
        ]
        return cls(tuple(offsets), flange)

    @classmethod
    def standard_dh(cls, rows: Sequence[DHRow]) -> Chain:
        """The chain of a standard table: ``T_i = Rz(q + theta) Tz(d) Tx(a) Rx(alpha)``.

        A joint of this convention turns about the z axis of the frame before its own, so the fixed part of a row is the
        offset of the next joint, and that of the last row leads to the flange.

        Args:
            rows: one for each joint.

        Returns:
            The chain; its link frames are those in which the joints turn, not the frames of the table.

        Raises:
            ValueError: if the last row leads off the last joint's axis.
        """
        *inner, last = rows
        if last.a or last.alpha:
            raise ValueError(f"the last row is {last}; expected a = 0 and alpha = 0: the flange lies on the last axis.")
        first = Offset((0.0, 0.0, 0.0), 0.0, rows[0].theta)
        following = [
            Offset((row.a, 0.0, row.d), row.alpha, after.theta) for row, after in zip(inner, rows[1:], strict=True)
        ]
        return cls((first, *following), last.d)


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
        """The same parameters in the frame of the link's joint, where they are given in that of a standard table.

        Args:
            row: the link's row of the standard table: it leads from the joint's frame to the table's.

        Returns:
            The parameters, with ``com = Tz(d) Tx(a) Rx(alpha) com``.
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
    """What the joints can do, one number (or interval) for each.

    Attributes:
        position_limits: [rad].
        velocity_limits: largest speed [rad/s].
        torque_limits: largest torque [N m].
        armature: inertia of the rotor as it is felt at the joint, behind the gear [kg m^2].
        inertia: typical diagonal of the joint-space inertia matrix, with armature: medians over the workspace of the
            tasks, from ``benchmarks/apparent_inertia.py`` [kg m^2].
    """

    position_limits: tuple[Limits, ...]
    velocity_limits: tuple[float, ...]
    torque_limits: tuple[float, ...]
    armature: tuple[float, ...]
    inertia: tuple[float, ...]

    def __post_init__(self) -> None:
        """Refuse tables of differing length, and numbers that no joint has."""
        lengths = {name: len(values) for name, values in vars(self).items()}
        if len(set(lengths.values())) != 1:
            raise ValueError(f"the joints' tables have lengths {lengths}; expected one number for each joint in each.")
        for index, (low, high) in enumerate(self.position_limits, start=1):
            if not low < high:
                raise ValueError(f"position_limits of joint {index} are ({low}, {high}); expected low < high [rad].")
        for name in ("velocity_limits", "torque_limits", "inertia"):
            _require_above(name, getattr(self, name), 0.0)
        if min(self.armature, default=0.0) < 0:
            raise ValueError(f"armature is {self.armature}; expected numbers of at least 0 kg m^2.")


class Shell(NamedTuple):
    """A primitive body that shows what a link looks like. It has no mass and touches nothing.

    Attributes:
        link: index of the link that carries it; 0 is the base.
        shape: ``"cylinder"`` or ``"capsule"``.
        colour: red, green, blue and opacity, each in [0, 1].
        radius: [m].
        start: centre of one end, in the link's frame [m].
        end: centre of the other end [m].
    """

    link: int
    shape: str
    colour: tuple[float, float, float, float]
    radius: float
    start: Vector3
    end: Vector3


@dataclass(frozen=True)
class Arm:
    """A serial arm with revolute joints, its base at the origin of the world and its z axis up.

    Attributes:
        name: short name, by which :func:`ppt_rl.arms.find_arm` finds it.
        chain: kinematic chain from base to flange.
        joints: limits and inertia of the joints.
        links: inertial parameters of the links that move.
        home: joint position in front of the base with the tool pointing down; inverse kinematics starts there and the
            nullspace posture holds it [rad].
        tool_turn: rotation of the tool's frame against the flange's about their common z axis [rad].
        reach: distance from the base's axis at which an upright tool can work at the table's height [m].
        apparent_inertia: typical inertia that the end effector shows to the world along x, y, z and about them: medians
            over the workspace of the tasks, from ``benchmarks/apparent_inertia.py`` [kg, kg m^2].
        shells: what the arm looks like.

    Raises:
        ValueError: if the parts describe different numbers of joints or a number is impossible.
    """

    name: str
    chain: Chain
    joints: Joints
    links: tuple[Inertial, ...]
    home: tuple[float, ...]
    tool_turn: float
    reach: Limits
    apparent_inertia: tuple[float, float, float, float, float, float]
    shells: tuple[Shell, ...] = ()

    @property
    def num_joints(self) -> int:
        """How many joints the arm has."""
        return len(self.chain.offsets)

    def __post_init__(self) -> None:
        """Refuse parts that do not fit together."""
        count = self.num_joints
        lengths = {"joints": len(self.joints.torque_limits), "links": len(self.links), "home": len(self.home)}
        if not count or set(lengths.values()) != {count}:
            raise ValueError(f"{self.name} has {count} offsets in its chain, but {lengths}; expected the same of each.")
        for index, (angle, (low, high)) in enumerate(zip(self.home, self.joints.position_limits, strict=True), start=1):
            if not low <= angle <= high:
                raise ValueError(f"home of joint {index} is {angle}; expected it within its limits ({low}, {high}).")
        _require_above("mass of the links", [link.mass for link in self.links], 0.0)
        _require_above("diagonal inertia of the links", [value for link in self.links for value in link.inertia[:3]], 0)
        _require_above("apparent_inertia", self.apparent_inertia, 0.0)
        if not 0 < self.reach.low < self.reach.high:
            raise ValueError(f"reach is {tuple(self.reach)}; expected 0 < low < high [m].")
        strange = [shell.link for shell in self.shells if not 0 <= shell.link <= count]
        if strange:
            raise ValueError(f"shells belong to links {strange}; expected 0 (the base) to {count}.")


def _require_above(name: str, values: Sequence[float], bound: float) -> None:
    if not all(value > bound and math.isfinite(value) for value in values):
        raise ValueError(f"{name}: {tuple(values)}; expected finite numbers above {bound:g}.")
