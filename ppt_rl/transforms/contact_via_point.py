"""Via-points from touch: where a wall is felt, the way along it is a place to pass."""

from __future__ import annotations

import math

import torch
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Binary, TensorSpec, Unbounded

from ppt_rl.functional.checks import require_positive
from ppt_rl.functional.contact import WallContact, is_touching, wall_contact
from ppt_rl.transforms.base import Entries, ObserverTransform
from ppt_rl.transforms.timed import TimedTransform

__all__ = ["ContactViaPointTransform"]


class ContactViaPointTransform(TimedTransform, ObserverTransform):
    r"""Turns contact with a wall into via-points along it, in a buffer of fixed size.

    While a wall is felt (:func:`~ppt_rl.functional.contact.wall_contact`), every ``spacing`` a via-point is set on the
    wall's tangent ``t``, a little off the wall whose normal is ``n``:

    .. math::
        y = x + v\,T\,t - b\,n, \qquad
        \Sigma = \sigma_t^2\, t t^\top + \sigma_n^2\, n n^\top + \sigma_z^2\, e_z e_z^\top

    due in the time ``T`` (``lookahead``). It takes the place of the one that is due first; those whose time has come
    are masked. Contact has hysteresis. A wall whose tangent is off the last via-point's by more than ``turn`` is new:
    the via-points along the old one are forgotten, and the first along it is set at once. Append it at control rate,
    before a :class:`MacroStepTransform`, which ``new_wall`` may interrupt; a :class:`ViaPointTransform` with a frame,
    appended after that, makes the posterior.

    State and observations: ``contact`` and ``new_wall`` ``(*B, 1)`` bool, ``via_phase`` ``(*B, M)``: time until due, as
    a share of the primitive's duration [-], ``via_position`` ``(*B, M, 3)`` world [m], ``via_cov`` ``(*B, M, 3, 3)``
    world axes [m^2], ``via_mask`` ``(*B, M)`` bool, ``via_tangent`` ``(*B, 2)`` of the last one [-], ``via_wait``
    ``(*B, 1)`` until the next one [s], ``via_pause`` ``(*B, 1)`` until a wall may be told to be new again [s].

    Args:
        duration: of the primitive [s].
        capacity: M, size of the buffer.
        lookahead: T, at most the duration [s].
        speed: v, along the wall [m/s].
        offset: b, off the wall [m].
        spacing: between via-points [s].
        turn: a wall is new where its tangent has turned by more than this, below pi [rad].
        pause: at least, from one ``new_wall`` that is told to the next [s].
        std: standard deviations along the wall, across it and in height [m].
        on: contact begins above this force on a wall [N].
        off: and ends below this [N].
        friction: estimate of walls and floor on the tool [-].
        slow: speed of a tool that is held up [m/s].
        dt: control step [s]; None takes it from the environment, and needs one.
        pose_key: end-effector pose.
        twist_key: measured twist.
        wrench_key: wrench on the world, smooth.
        heading_key: heading of the tool.

    Raises:
        KeyError: if an observation is missing.
        ValueError: if a number is out of range.

    Source:
        Paper, section "Trajectory Posterior via Via-Point Conditioning"; how contact makes via-points is ours.
    """

    state_keys = (
        "contact", "new_wall", "via_mask", "via_wait", "via_pause", "via_phase", "via_tangent", "via_position",
        "via_cov",
    )  # fmt: skip
    _hint = " HeadingFrameTransform writes heading and smooth_wrench."

    def __init__(
        self,
        duration: float,
        *,
        capacity: int = 8,
        lookahead: float = 0.6,
        speed: float = 0.06,
        offset: float = 0.002,
        spacing: float = 0.05,
        turn: float = 0.3,
        pause: float = 0.1,
        std: tuple[float, float, float] = (0.02, 0.004, 0.02),
        on: float = 1.0,
        off: float = 0.5,
        friction: float = 0.25,
        slow: float = 0.01,
        dt: float | None = None,
        pose_key: NestedKey = "pose",
        twist_key: NestedKey = "twist",
        wrench_key: NestedKey = "smooth_wrench",
        heading_key: NestedKey = "heading",
    ) -> None:
        super().__init__(in_keys=[pose_key, twist_key, wrench_key, heading_key], out_keys=[])
        self.duration = require_positive("duration", duration, "s")
        self.lookahead = require_positive("lookahead", lookahead, "s")
        if self.lookahead > self.duration:
            raise ValueError(f"lookahead is {lookahead} s; expected at most the primitive's duration, {duration} s.")
        if capacity < 1:
            raise ValueError(f"capacity is {capacity}; expected at least 1.")
        if not on >= off > 0:
            raise ValueError(f"on and off are {on} and {off} N; expected on >= off > 0.")
        if offset < 0:
            raise ValueError(f"offset is {offset} m; expected at least 0.")
        self.capacity, self.offset, self.on, self.off = int(capacity), float(offset), float(on), float(off)
        self.speed = require_positive("speed", speed, "m/s")
        self.spacing = require_positive("spacing", spacing, "s")
        if not 0 < turn < math.pi:
            raise ValueError(f"turn is {turn} rad; expected a number above 0 and below pi.")
        self.turn, self.pause = float(turn), require_positive("pause", pause, "s")
        self.friction = require_positive("friction", friction)
        self.slow = require_positive("slow", slow, "m/s")
        self.dt = dt
        if len(std) != 3:
            raise ValueError(f"std is {std}; expected three numbers: along the wall, across it, in height [m].")
        self.register_buffer("variance", torch.tensor([require_positive("std", value, "m") ** 2 for value in std]))

    def _begin(self, *readings: Tensor) -> Entries:
        return self._empty(readings[0])

    def _update(self, state: Entries, *readings: Tensor) -> Entries:
        pose, twist, wrench, heading = readings
        wall = wall_contact(wrench[..., :3], twist[..., :2], heading, friction=self.friction, slow=self.slow)
        return self._updated(state, pose, wall)

    def _updated(self, old: Entries, pose: Tensor, wall: WallContact) -> Entries:
        size = torch.linalg.vector_norm(wall.force, dim=-1, keepdim=True)
        contact = is_touching(old["contact"], size, on=self.on, off=self.off)
        same = (wall.tangent * old["via_tangent"]).sum(-1, keepdim=True) >= math.cos(self.turn)
        new = contact & ~same
        dt = self.dt
        wait, pause = ((old[key] - dt).clamp_min(0.0) for key in ("via_wait", "via_pause"))
        told = new & (pause < 0.5 * dt)
        phase = (old["via_phase"] - dt / self.duration).clamp_min(0.0)
        mask = old["via_mask"] & (phase > 0.5 * dt / self.duration) & ~new  # due, but for the rounding of a sum
        sets = new | contact & (wait < 0.5 * dt)  # (*B, 1)
        # The slot that is due first, an empty one before all others.
        slot = torch.where(mask, phase, -torch.ones_like(phase)).argmin(-1, keepdim=True)
        chosen = sets & (torch.arange(self.capacity, device=phase.device) == slot)  # (*B, M)
        position, cov = self._via_point(pose, wall)
        return {
            "contact": contact,
            "new_wall": told,
            "via_wait": torch.where(sets, self.spacing, wait),
            "via_pause": torch.where(told, self.pause, pause),
            "via_tangent": torch.where(sets, wall.tangent, old["via_tangent"]),
            "via_phase": torch.where(chosen, self.lookahead / self.duration, phase),
            "via_mask": mask | chosen,
            "via_position": torch.where(chosen.unsqueeze(-1), position.unsqueeze(-2), old["via_position"]),
            "via_cov": torch.where(chosen[..., None, None], cov.unsqueeze(-3), old["via_cov"]),
        }

    def _via_point(self, pose: Tensor, wall: WallContact) -> tuple[Tensor, Tensor]:
        """Position ``(*B, 3)`` and covariance ``(*B, 3, 3)`` of a via-point, world."""
        zero = torch.zeros_like(wall.tangent[..., :1])
        tangent, normal = torch.cat([wall.tangent, zero], -1), torch.cat([wall.normal, zero], -1)
        up = torch.cat([zero, zero, torch.ones_like(zero)], -1)
        axes = torch.stack([tangent, normal, up], -1)  # columns
        cov = (axes * self.variance.to(axes)) @ axes.mT
        return pose[..., :3] + self.speed * self.lookahead * tangent - self.offset * normal, cov

    # -- state --------------------------------------------------------------------------------------------------------

    def _empty(self, pose: Tensor) -> Entries:
        batch, size = pose.shape[:-1], self.capacity
        flag = torch.zeros(*batch, size, dtype=torch.bool, device=pose.device)
        return {
            "contact": flag[..., :1].clone(),
            "new_wall": flag[..., :1].clone(),
            "via_wait": pose.new_zeros(*batch, 1),
            "via_pause": pose.new_zeros(*batch, 1),
            "via_tangent": pose.new_zeros(*batch, 2),
            "via_phase": pose.new_zeros(*batch, size),
            "via_mask": flag,
            "via_position": pose.new_zeros(*batch, size, 3),
            "via_cov": self.variance.to(pose).diag_embed().expand(*batch, size, 3, 3).clone(),
        }

    def _state_specs(self, batch: torch.Size, like: TensorSpec) -> dict[NestedKey, TensorSpec]:
        def real(*shape: int) -> Unbounded:
            return Unbounded(shape=(*batch, *shape), dtype=like.dtype, device=like.device)

        def flag(count: int) -> Binary:
            return Binary(n=count, shape=(*batch, count), dtype=torch.bool, device=like.device)

        size = self.capacity
        return {
            "contact": flag(1), "new_wall": flag(1), "via_mask": flag(size), "via_wait": real(1), "via_pause": real(1),
            "via_phase": real(size), "via_tangent": real(2), "via_position": real(size, 3), "via_cov": real(size, 3, 3),
        }  # fmt: skip
