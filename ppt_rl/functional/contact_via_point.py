"""Via-points from touch: a buffer of places along the walls that a tool has felt."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from numbers import Real
from typing import NamedTuple

import torch
from torch import Tensor

from ppt_rl.functional.argument_checks import require_in_range, require_numbers, require_whole
from ppt_rl.functional.checks import require_last_dim, require_positive
from ppt_rl.functional.contact import WallContact

__all__ = ["ContactViaPoints", "ViaPointConfig", "begin_via_points", "update_via_points"]


#: Largest number of via-points in a buffer.
_MOST = 1000


@dataclass(frozen=True)
class ViaPointConfig:
    """Where and when contact with a wall sets a via-point.

    Attributes:
        capacity: M, number of via-points in the buffer, at most 1000.
        lookahead: T, time from setting a via-point until it is due [s].
        speed: v, speed along the wall [m/s]: a via-point lies ``v T`` ahead of the tool.
        offset: b, distance of a via-point from the line along the wall through the tool, away from the wall [m].
        spacing: time from one via-point to the next [s].
        turn: a wall is new if its tangent differs from the last via-point's by more than this angle [rad], below pi.
        pause: shortest time from one ``new_wall`` to the next [s].
        std: standard deviations of a via-point along the wall, across it and in height [m].
    """

    capacity: int = 8
    lookahead: float = 0.6
    speed: float = 0.06
    offset: float = 0.002
    spacing: float = 0.05
    turn: float = 0.3
    pause: float = 0.1
    std: tuple[float, float, float] = (0.02, 0.004, 0.02)

    def __post_init__(self) -> None:
        """Refuse impossible numbers."""
        require_whole("capacity", self.capacity, 1, _MOST)
        for name, unit in (("lookahead", "s"), ("speed", "m/s"), ("spacing", "s"), ("pause", "s")):
            require_positive(name, getattr(self, name), unit)
        require_in_range("offset", self.offset, 0.0, unit="m")
        if not isinstance(self.turn, Real) or not 0 < self.turn < math.pi:
            raise ValueError(f"turn is {self.turn} rad; expected a number above 0 and below pi.")
        require_numbers("std", self.std, (3,), unit="m")
        for value in self.std:
            require_positive("std", value, "m")

    @cached_property
    def variance(self) -> Tensor:
        """``(3,)`` variances along the wall, across it and in height [m^2]."""
        return torch.tensor([value**2 for value in self.std], dtype=torch.float64)


class ContactViaPoints(NamedTuple):
    r"""A buffer of M via-points, with what is remembered of the wall.

    A via-point that is set while the tool is at ``x`` lies ahead along the wall's tangent ``t``, a little off the wall
    whose normal is ``n``, and is due after the time ``T``:

    .. math::
        y = x + v\,T\,t - b\,n, \qquad
        \Sigma = \sigma_t^2\, t t^\top + \sigma_n^2\, n n^\top + \sigma_z^2\, e_z e_z^\top

    Attributes:
        contact: ``(*B, 1)`` bool, whether the tool touches a wall.
        new_wall: ``(*B, 1)`` bool, whether it has just met another wall than before.
        via_mask: ``(*B, M)`` bool, which via-points there are.
        via_wait: ``(*B, 1)`` time until the next via-point may be set [s].
        via_pause: ``(*B, 1)`` time until the next ``new_wall`` may be reported [s].
        via_phase: ``(*B, M)`` time until each via-point is due, as a share of the primitive's duration [-].
        via_tangent: ``(*B, 2)`` unit vector along the wall at the last via-point, world axes on the map [-].
        via_position: ``(*B, M, 3)`` in world coordinates [m].
        via_cov: ``(*B, M, 3, 3)`` covariances, world axes [m^2].
    """

    contact: Tensor
    new_wall: Tensor
    via_mask: Tensor
    via_wait: Tensor
    via_pause: Tensor
    via_phase: Tensor
    via_tangent: Tensor
    via_position: Tensor
    via_cov: Tensor


def begin_via_points(pose: Tensor, config: ViaPointConfig) -> ContactViaPoints:
    """An empty buffer.

    Args:
        pose: ``(*B, 7)`` pose of the end effector, for batch, dtype and device.
        config: numbers of the law.

    Returns:
        The buffer, without contact.

    Raises:
        ValueError: if the pose has another shape.
    """
    require_last_dim("pose", pose, 7)
    batch, size = pose.shape[:-1], config.capacity
    flag = torch.zeros(*batch, size, dtype=torch.bool, device=pose.device)
    return ContactViaPoints(
        contact=flag[..., :1].clone(),
        new_wall=flag[..., :1].clone(),
        via_mask=flag,
        via_wait=pose.new_zeros(*batch, 1),
        via_pause=pose.new_zeros(*batch, 1),
        via_phase=pose.new_zeros(*batch, size),
        via_tangent=pose.new_zeros(*batch, 2),
        via_position=pose.new_zeros(*batch, size, 3),
        via_cov=config.variance.to(pose).diag_embed().expand(*batch, size, 3, 3).clone(),
    )


def update_via_points(
    old: ContactViaPoints,
    pose: Tensor,
    wall: WallContact,
    contact: Tensor,
    config: ViaPointConfig,
    *,
    duration: float,
    dt: float,
) -> ContactViaPoints:
    """The buffer after one more control step.

    In contact, a via-point is set every ``spacing`` and replaces the one that is due first. Those whose time has come
    are masked. If the wall is new, the via-points along the old one are dropped, and one along the new one is set at
    once.

    Args:
        old: the buffer.
        pose: ``(*B, 7)`` pose of the end effector, world.
        wall: the wall as the tool feels it.
        contact: ``(*B, 1)`` whether the tool touches a wall.
        config: numbers of the law.
        duration: duration of the primitive that is conditioned [s].
        dt: control step [s].

    Returns:
        The new buffer.
    """
    same = (wall.tangent * old.via_tangent).sum(-1, keepdim=True) >= math.cos(config.turn)
    new = contact & ~same
    wait, pause = ((time - dt).clamp_min(0.0) for time in (old.via_wait, old.via_pause))
    reported = new & (pause < 0.5 * dt)
    phase = (old.via_phase - dt / duration).clamp_min(0.0)
    mask = old.via_mask & (phase > 0.5 * dt / duration) & ~new  # half a step allows for the rounding of the sum
    sets = new | contact & (wait < 0.5 * dt)  # (*B, 1)
    chosen = sets & _is_due_first(phase, mask)  # (*B, M)
    position, cov = _via_point(pose, wall, config)
    return ContactViaPoints(
        contact=contact,
        new_wall=reported,
        via_mask=mask | chosen,
        via_wait=torch.where(sets, config.spacing, wait),
        via_pause=torch.where(reported, config.pause, pause),
        via_phase=torch.where(chosen, config.lookahead / duration, phase),
        via_tangent=torch.where(sets, wall.tangent, old.via_tangent),
        via_position=torch.where(chosen.unsqueeze(-1), position.unsqueeze(-2), old.via_position),
        via_cov=torch.where(chosen[..., None, None], cov.unsqueeze(-3), old.via_cov),
    )


def _is_due_first(phase: Tensor, mask: Tensor) -> Tensor:
    """Marks, ``(*B, M)``, the via-point that is due first; an empty slot precedes all others."""
    slot = torch.where(mask, phase, -torch.ones_like(phase)).argmin(-1, keepdim=True)
    return torch.arange(phase.shape[-1], device=phase.device) == slot


def _via_point(pose: Tensor, wall: WallContact, config: ViaPointConfig) -> tuple[Tensor, Tensor]:
    """Position ``(*B, 3)`` and covariance ``(*B, 3, 3)`` of a via-point, world."""
    zero = torch.zeros_like(wall.tangent[..., :1])
    tangent, normal = torch.cat([wall.tangent, zero], -1), torch.cat([wall.normal, zero], -1)
    up = torch.cat([zero, zero, torch.ones_like(zero)], -1)
    axes = torch.stack([tangent, normal, up], -1)  # columns
    cov = (axes * config.variance.to(axes)) @ axes.mT
    return pose[..., :3] + config.speed * config.lookahead * tangent - config.offset * normal, cov
