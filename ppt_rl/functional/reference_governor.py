"""A reference that an impedance controller may follow without pushing harder than a limit."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ppt_rl.functional.checks import require_last_dim
from ppt_rl.functional.impedance import orientation_error
from ppt_rl.functional.rotations import quat_conjugate, quat_multiply
from ppt_rl.functional.shape_checks import require_same_batch

__all__ = ["GovernedReference", "catch_up", "govern_reference", "limit_drive"]


class GovernedReference(NamedTuple):
    """A reference within the limits.

    Attributes:
        pose: ``(*B, 7)`` in world [m, -].
        twist: ``(*B, 6)`` in world axes [m/s, rad/s].
        lag: ``(*B, 2)`` how far the pose is behind the one that was asked for [m, rad]; exactly zero where it is that
            one.
    """

    pose: Tensor
    twist: Tensor
    lag: Tensor


def govern_reference(
    reference: Tensor,
    pose: Tensor,
    stiffness: Tensor,
    damping: Tensor,
    last: Tensor,
    lag: Tensor,
    *,
    limits: tuple[float, float],
    speeds: tuple[float, float],
    dt: float,
    moving: Tensor | None = None,
) -> GovernedReference:
    """One control step of the governor: :func:`catch_up`, then :func:`limit_drive`.

    Where the reference did not lag and its drive is within the limits, the result is the reference itself, bit by bit.
    Translation and rotation are governed separately.

    Args:
        reference: ``(*B, 13)`` pose and twist that are asked for.
        pose: ``(*B, 7)`` measured pose.
        stiffness: ``(*B, 6)`` diagonal of K [N/m, N m/rad].
        damping: ``(*B, 6)`` diagonal of D [N s/m, N m s/rad].
        last: ``(*B, 7)`` governed pose of the last control step.
        lag: ``(*B, 2)`` its lag [m, rad].
        limits: largest drive [N] and [N m].
        speeds: largest speed of the governed pose while it lags [m/s] and [rad/s].
        dt: control step [s].
        moving: as for :func:`limit_drive`.

    Returns:
        Governed pose and twist, and the lag.

    Raises:
        ValueError: if a shape does not fit.
    """
    require_last_dim("reference (pose and twist)", reference, 13)
    asked, twist = reference[..., :7], reference[..., 7:]
    candidate, twist = catch_up(asked, twist, last, lag, speeds=speeds, dt=dt)
    governed, twist = limit_drive(pose, candidate, twist, stiffness, damping, limits=limits, moving=moving)
    behind = torch.linalg.vector_norm(asked[..., :3] - governed[..., :3], dim=-1, keepdim=True)
    same = (asked[..., 3:] == governed[..., 3:]).all(-1, keepdim=True)
    turned = torch.where(same, 0.0, 2 * _half_angle(_between(governed[..., 3:], asked[..., 3:])))
    return GovernedReference(governed, twist, torch.cat([behind, turned], -1))


def catch_up(
    pose: Tensor, twist: Tensor, last: Tensor, lag: Tensor, *, speeds: tuple[float, float], dt: float
) -> tuple[Tensor, Tensor]:
    r"""Bound the motion of a reference that lags behind the one that is asked for.

    .. math:: x_c = x_l + (x_a - x_l) \min\Big(1, \frac{c\,\Delta t}{\lVert x_a - x_l \rVert}\Big), \qquad
        v_c = v_a \min\Big(1, \frac{c}{\lVert v_a \rVert}\Big)

    where the last governed position ``x_l`` lagged; elsewhere, and where the asked-for position ``x_a`` is within
    ``c dt`` of it, ``x_c = x_a`` and ``v_c = v_a``. Rotation follows the same law with the angle between orientations.

    Args:
        pose: ``(*B, 7)`` asked for.
        twist: ``(*B, 6)`` asked for.
        last: ``(*B, 7)`` governed pose of the last control step.
        lag: ``(*B, 2)`` its lag [m, rad]; zero stands for none.
        speeds: c, for translation [m/s] and rotation [rad/s].
        dt: control step [s].

    Returns:
        Pose ``(*B, 7)`` and twist ``(*B, 6)``.

    Raises:
        ValueError: if a shape does not fit.
    """
    for name, value, size in (("pose", pose, 7), ("twist", twist, 6), ("last", last, 7), ("lag", lag, 2)):
        require_last_dim(name, value, size)
    require_same_batch(pose=pose, twist=twist, last=last, lag=lag)
    gap = pose[..., :3] - last[..., :3]
    distance = torch.linalg.vector_norm(gap, dim=-1, keepdim=True)
    linear = (lag[..., :1] > 0) & ~(distance <= speeds[0] * dt)
    position = last[..., :3] + _times(speeds[0] * dt / distance.clamp_min(speeds[0] * dt), gap)
    turn = _between(last[..., 3:], pose[..., 3:])
    half, step = _half_angle(turn), 0.5 * speeds[1] * dt
    angular = (lag[..., 1:] > 0) & ~(half <= step)
    tiny = torch.finfo(turn.dtype).tiny
    axis = turn[..., 1:] / torch.linalg.vector_norm(turn[..., 1:], dim=-1, keepdim=True).clamp_min(tiny)
    part = half.clamp_max(step)
    orientation = quat_multiply(torch.cat([part.cos(), part.sin() * axis], -1), last[..., 3:])
    slow = torch.cat([_within(twist[..., :3], speeds[0]), _within(twist[..., 3:], speeds[1])], -1)
    return (
        torch.where(_mask(linear, angular, 4), torch.cat([position, orientation], -1), pose),
        torch.where(_mask(linear, angular, 3), slow, twist),
    )


def limit_drive(
    pose: Tensor,
    reference_pose: Tensor,
    reference_twist: Tensor,
    stiffness: Tensor,
    damping: Tensor,
    *,
    limits: tuple[float, float],
    moving: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    r"""Draw a reference towards the tool until the drive of the impedance is within its limit.

    The drive is what spring and feed-forward together push with, and so the force on a tool that is held still:

    .. math:: f = K\,(x_d - x) + D\,v_d, \qquad
        x' = x + \rho\,(x_d - x),\quad v' = \rho\,v_d,\quad \rho = \min\Big(1, \frac{f_{max}}{\lVert f \rVert}\Big)

    Hence ``||K (x' - x) + D v'|| <= f_max`` for every input, up to the rounding of the stored position, which is worth
    K times half a unit in its last place. It bounds the speed as well: without a resistance the arm moves steadily at
    no more than ``f_max / d``.

    Given the measured twist ``v`` (``moving``), the law bounds what exceeds the force that the damper takes to keep up
    the motion that there is:

    .. math:: c = \mathrm{clip}\Big(\frac{f \cdot D v}{\lVert D v \rVert^2}, 0, 1\Big), \quad
        \rho = \min\Big(1, \frac{f_{max}}{\lVert f - c D v \rVert}\Big), \quad v' = \rho\,v_d + (1 - \rho)\,c\,v

    Then the wrench ``K (x' - x) + D (v' - v)`` is the sum of a force of at most ``f_max`` and of ``-(1 - c) D v``,
    which only brakes. A tool that is held still has ``v = 0``: the limit on it is the same, but none on the speed is
    left.

    Rotation follows the same law with the :func:`~ppt_rl.functional.impedance.orientation_error`: the governed
    orientation is the one about the same axis whose error is ``rho`` times as large.

    Args:
        pose: ``(*B, 7)`` measured pose.
        reference_pose: ``(*B, 7)`` desired pose.
        reference_twist: ``(*B, 6)`` desired twist.
        stiffness: ``(*B, 6)`` diagonal of K [N/m, N m/rad].
        damping: ``(*B, 6)`` diagonal of D [N s/m, N m s/rad].
        limits: largest drive [N] and [N m].
        moving: ``(*B, 6)`` measured twist; None stands for the plain limit.

    Returns:
        Pose ``(*B, 7)`` and twist ``(*B, 6)``; the reference's own, bit by bit, where they are within the limits.

    Raises:
        ValueError: if a shape does not fit.
    """
    for name, value, size in (
        ("pose", pose, 7), ("reference_pose", reference_pose, 7), ("reference_twist", reference_twist, 6),
        ("stiffness", stiffness, 6), ("damping", damping, 6),
    ):  # fmt: skip
        require_last_dim(name, value, size)
    if moving is not None:
        require_last_dim("moving", moving, 6)
    require_same_batch(
        pose=pose, reference_pose=reference_pose, reference_twist=reference_twist, stiffness=stiffness, damping=damping
    )
    errors = reference_pose[..., :3] - pose[..., :3], orientation_error(pose[..., 3:], reference_pose[..., 3:])
    position, velocity, limited = _drawn(0, errors[0], reference_twist, stiffness, damping, limits[0], moving)
    turn, rate, held = _drawn(1, errors[1], reference_twist, stiffness, damping, limits[1], moving)
    drawn = torch.cat([pose[..., :3] + position, quat_multiply(_small_turn(turn), pose[..., 3:])], -1)
    return (
        torch.where(_mask(limited, held, 4), drawn, reference_pose),
        torch.where(_mask(limited, held, 3), torch.cat([velocity, rate], -1), reference_twist),
    )


def _drawn(
    part: int, error: Tensor, twist: Tensor, stiffness: Tensor, damping: Tensor, limit: float, moving: Tensor | None
) -> tuple[Tensor, Tensor, Tensor]:
    """Error and velocity of one half (0 linear, 1 angular) drawn to the limit, and where that is needed."""
    own = slice(3 * part, 3 * part + 3)
    velocity, damping = twist[..., own], damping[..., own]
    drive = stiffness[..., own] * error + damping * velocity
    anchor = torch.zeros_like(velocity)
    if moving is not None:
        drag = damping * moving[..., own]
        tiny = torch.finfo(drag.dtype).tiny
        along = (drive * drag).sum(-1, keepdim=True) / drag.square().sum(-1, keepdim=True).clamp_min(tiny)
        share = along.clamp(0.0, 1.0).nan_to_num(0.0)
        anchor, drive = share * moving[..., own], drive - share * drag
    size = torch.linalg.vector_norm(drive, dim=-1, keepdim=True)
    limited = ~(size <= limit)  # so is a drive that is too large for the format
    ratio = limit * (1 - 4 * torch.finfo(size.dtype).eps) / size.clamp_min(limit)
    ratio = torch.where(size.isfinite(), ratio, 0.0)
    return _times(ratio, error), _times(ratio, velocity) + (1 - ratio) * anchor, limited


def _mask(linear: Tensor, angular: Tensor, size: int) -> Tensor:
    """``(*B, 3 + size)`` from one flag for position or velocity and one for orientation or rate."""
    lead = linear.shape[:-1]
    return torch.cat([linear.expand(*lead, 3), angular.expand(*lead, size)], -1)


def _times(factor: Tensor, value: Tensor) -> Tensor:
    """A product in which zero times infinity is zero."""
    return torch.where(factor > 0, factor * value, 0.0)


def _within(vector: Tensor, longest: float) -> Tensor:
    """A vector scaled to a largest length."""
    size = torch.linalg.vector_norm(vector, dim=-1, keepdim=True)
    return _times(longest / size.clamp_min(longest), vector)


def _between(start: Tensor, end: Tensor) -> Tensor:
    """The shorter rotation in world axes that leads from one orientation to another, with ``w >= 0``."""
    turn = quat_multiply(end, quat_conjugate(start))
    return torch.where(turn[..., :1] < 0, -turn, turn)


def _half_angle(turn: Tensor) -> Tensor:
    """``(*B, 1)`` half the angle of a rotation with ``w >= 0``, in [0, pi/2] [rad]."""
    return torch.atan2(torch.linalg.vector_norm(turn[..., 1:], dim=-1, keepdim=True), turn[..., :1])


def _small_turn(error: Tensor) -> Tensor:
    """The rotation of at most a right angle about ``error`` whose sine is its length (at most 1)."""
    cosine = (1 - error.square().sum(-1, keepdim=True)).clamp(0.0, 1.0).sqrt()
    w = (0.5 * (1 + cosine)).sqrt()
    return torch.cat([w, 0.5 * error / w], -1)
