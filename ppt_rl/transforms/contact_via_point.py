"""Via-points from touch: where the tool feels a wall, it places via-points along that wall."""

from __future__ import annotations

import torch
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Binary, TensorSpec

from ppt_rl.functional.argument_checks import require_instance
from ppt_rl.functional.checks import require_positive
from ppt_rl.functional.contact import WallTouch, is_touching, wall_contact
from ppt_rl.functional.contact_via_point import (
    ContactViaPoints,
    ViaPointConfig,
    begin_via_points,
    update_via_points,
)
from ppt_rl.transforms.base import Entries
from ppt_rl.transforms.observer import ObserverTransform
from ppt_rl.transforms.specs import real
from ppt_rl.transforms.timed import TimedTransform

__all__ = ["ContactViaPointTransform"]


class ContactViaPointTransform(TimedTransform, ObserverTransform):
    r"""Turns contact with a wall into via-points along it, in a buffer of fixed size.

    While the tool feels a wall (:func:`~ppt_rl.functional.contact.wall_contact`), via-points are set at regular times
    ahead of it, along the wall. A wall whose tangent has turned is new: the via-points along the old one are dropped.
    The law is :func:`~ppt_rl.functional.contact_via_point.update_via_points`.

    Append it at control rate, before a :class:`MacroStepTransform`, which ``new_wall`` may interrupt. A
    :class:`ViaPointTransform` with a frame, appended after the macro step, computes the posterior.

    State and observations are the fields of :class:`~ppt_rl.functional.contact_via_point.ContactViaPoints`, which gives
    their shapes and units: ``contact``, ``new_wall``, ``via_phase``, ``via_position``, ``via_cov``, ``via_mask``,
    ``via_tangent``, ``via_wait``, ``via_pause``.

    Args:
        duration: duration of the primitive [s].
        config: where and when via-points are set; None takes the defaults.
        touch: how a wall is felt; None takes the defaults.
        dt: control step [s]; None takes it from the environment, and needs one.
        pose_key: end-effector pose.
        twist_key: measured twist.
        wrench_key: smooth wrench on the world.
        heading_key: heading of the tool.

    Raises:
        KeyError: if an observation is missing.
        ValueError: if a number is out of range, or the lookahead longer than the duration.

    Source:
        Paper, section "Trajectory Posterior via Via-Point Conditioning"; how contact makes via-points is ours.
    """

    _at_control_rate = True
    state_keys = ContactViaPoints._fields
    _hint = " HeadingFrameTransform writes heading and smooth_wrench."

    def __init__(
        self,
        duration: float,
        config: ViaPointConfig | None = None,
        touch: WallTouch | None = None,
        *,
        dt: float | None = None,
        pose_key: NestedKey = "pose",
        twist_key: NestedKey = "twist",
        wrench_key: NestedKey = "smooth_wrench",
        heading_key: NestedKey = "heading",
    ) -> None:
        super().__init__(in_keys=[pose_key, twist_key, wrench_key, heading_key], out_keys=[])
        self.duration = require_positive("duration", duration, "s")
        self.config = ViaPointConfig() if config is None else config
        self.touch = WallTouch() if touch is None else touch
        require_instance("config", self.config, ViaPointConfig)
        require_instance("touch", self.touch, WallTouch)
        if self.config.lookahead > self.duration:
            raise ValueError(
                f"lookahead is {self.config.lookahead} s; expected at most the primitive's duration, {duration} s."
            )
        self.dt = dt

    def _begin(self, *readings: Tensor) -> Entries:
        return begin_via_points(readings[0], self.config)._asdict()

    def _update(self, state: Entries, *readings: Tensor) -> Entries:
        pose, twist, wrench, heading = readings
        old, touch = ContactViaPoints(**state), self.touch
        wall = wall_contact(wrench[..., :3], twist[..., :2], heading, friction=touch.friction, slow=touch.slow)
        size = torch.linalg.vector_norm(wall.force, dim=-1, keepdim=True)  # [N]
        contact = is_touching(old.contact, size, on=touch.on, off=touch.off)
        new = update_via_points(old, pose, wall, contact, self.config, duration=self.duration, dt=self.dt)
        return new._asdict()

    def _state_specs(self, batch: torch.Size, like: TensorSpec) -> dict[NestedKey, TensorSpec]:
        def spec(value: Tensor) -> TensorSpec:
            if value.dtype is torch.bool:
                return Binary(n=value.shape[-1], shape=value.shape, dtype=torch.bool, device=like.device)
            return real(like, *value.shape)

        pose = torch.empty(*batch, 7, dtype=like.dtype, device=like.device)
        return {key: spec(value) for key, value in begin_via_points(pose, self.config)._asdict().items()}
