"""Kinematic chains of revolute joints, from Denavit-Hartenberg tables of either convention."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real
from typing import NamedTuple

__all__ = ["Chain", "DHRow", "Offset"]

Vector3 = tuple[float, float, float]


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

    Link ``i`` carries the frame of joint ``i``. Flange and tool lie on the axis of the last joint.

    Attributes:
        offsets: one for each joint, from the base outwards.
        flange: distance from the last joint's frame to the flange along its z axis [m].
        tool_turn: angle from the last joint's frame to the tool's about that axis [rad].

    Raises:
        ValueError: if there is no joint, or a number is not finite.
    """

    offsets: tuple[Offset, ...]
    flange: float
    tool_turn: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a chain without joints and numbers that no chain has."""
        if not self.offsets:
            raise ValueError("offsets is empty; expected one Offset for each joint.")
        for index, offset in enumerate(self.offsets, start=1):
            if not isinstance(offset, Offset):
                raise ValueError(f"offset of joint {index} is {offset!r}; expected an Offset.")
            _require_finite(f"offset of joint {index}", (*offset.position, offset.twist, offset.turn))
        _require_finite("flange", (self.flange,))
        _require_finite("tool_turn", (self.tool_turn,))

    @classmethod
    def modified_dh(cls, rows: Sequence[DHRow], *, flange: float, tool_turn: float = 0.0) -> Chain:
        """Build the chain of a modified (Craig) table: ``T_i = Rx(alpha) Tx(a) Rz(q + theta) Tz(d)``.

        Args:
            rows: one for each joint.
            flange: distance from the last joint's frame to the flange along its z axis [m].
            tool_turn: angle from the last joint's frame to the tool's about that axis [rad].

        Returns:
            The chain; its link frames are the frames of the table.

        Raises:
            ValueError: if there is no row, or a number is not finite.
        """
        _check_rows(rows)
        offsets = [
            Offset((row.a, -math.sin(row.alpha) * row.d, math.cos(row.alpha) * row.d), row.alpha, row.theta)
            for row in rows
        ]
        return cls(tuple(offsets), flange, tool_turn)

    @classmethod
    def standard_dh(cls, rows: Sequence[DHRow], *, tool_turn: float = 0.0) -> Chain:
        """Build the chain of a standard table: ``T_i = Rz(q + theta) Tz(d) Tx(a) Rx(alpha)``.

        In this convention joint ``i`` turns about the z axis of frame ``i - 1``. The fixed part of a row is therefore
        the offset of the next joint, and the fixed part of the last row leads to the flange.

        Args:
            rows: one for each joint.
            tool_turn: angle from the last joint's frame to the tool's about its z axis [rad].

        Returns:
            The chain; its link frames are not those of the table (see :meth:`Inertial.in_joint_frame`).

        Raises:
            ValueError: if there is no row, a number is not finite, or the flange is not on the last joint's axis.
        """
        _check_rows(rows)
        *inner, last = rows
        if last.a or last.alpha:
            raise ValueError(
                f"the last row is {last}; expected a = 0 and alpha = 0, a flange on the last joint's axis."
            )
        first = Offset((0.0, 0.0, 0.0), 0.0, rows[0].theta)
        following = [
            Offset((row.a, 0.0, row.d), row.alpha, after.theta) for row, after in zip(inner, rows[1:], strict=True)
        ]
        return cls((first, *following), last.d, tool_turn)


def _check_rows(rows: Sequence[DHRow]) -> None:
    if not rows:
        raise ValueError("rows is empty; expected one DHRow for each joint.")
    for index, row in enumerate(rows, start=1):
        if not isinstance(row, DHRow):
            raise ValueError(f"row {index} is {row!r}; expected a DHRow.")
        _require_finite(f"row {index}", row)


def _require_finite(name: str, values: Sequence[float]) -> None:
    if not all(isinstance(value, Real) and math.isfinite(value) for value in values):
        shown = values[0] if len(values) == 1 else tuple(values)
        raise ValueError(f"{name} is {shown!r}; expected finite numbers [m, rad].")
