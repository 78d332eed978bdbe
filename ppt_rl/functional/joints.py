"""Laws in joint space: difference of joint positions, and a spring and a damper in each joint."""

from __future__ import annotations

import math

import torch
from torch import Tensor

__all__ = ["joint_difference", "joint_effort"]


def joint_difference(position: Tensor, other: Tensor, continuous: Tensor) -> Tensor:
    r"""``position - other``, for continuous joints by the shorter way round.

    .. math:: d = q - q', \qquad d_c \leftarrow d_c - 2\pi\,\mathrm{round}(d_c / 2\pi)

    Args:
        position: ``(*B, D)`` joint positions [rad].
        other: ``(*B, D)`` joint positions [rad].
        continuous: ``(D,)`` bool, True for a joint that turns without end, whose position is known up to whole turns.

    Returns:
        ``(*B, D)`` difference, within half a turn for continuous joints [rad].
    """
    difference = position - other
    turns = (difference / (2 * math.pi)).round()
    return torch.where(continuous, difference - 2 * math.pi * turns, difference)


def joint_effort(position_error: Tensor, velocity_error: Tensor, stiffness: Tensor, damping: Tensor) -> Tensor:
    r"""Effort of a spring and a damper in each joint: ``K e + D \dot e``.

    Args:
        position_error: ``(*B, D)`` desired minus measured position [rad], or [m] for sliding joints.
        velocity_error: ``(*B, D)`` desired minus measured velocity [rad/s], [m/s].
        stiffness: ``(D,)`` diagonal of K [N m/rad], [N/m].
        damping: ``(D,)`` diagonal of D [N m s/rad], [N s/m].

    Returns:
        ``(*B, D)`` effort [N m], [N].
    """
    return stiffness * position_error + damping * velocity_error
