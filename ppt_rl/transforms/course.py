"""Where a sliding tool came from: a memory of its course, with which it can tell ahead from back."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import TensorSpec

from ppt_rl.functional.checks import require_last_dim, require_positive
from ppt_rl.functional.heading import follow_course
from ppt_rl.transforms.base import Entries
from ppt_rl.transforms.observer import ObserverTransform
from ppt_rl.transforms.specs import real
from ppt_rl.transforms.timed import TimedTransform

__all__ = ["CourseTransform"]


class CourseTransform(TimedTransform, ObserverTransform):
    r"""Remembers the course of a tool and writes how far its heading has turned away from it, and how fast it turns.

    .. math::
        \delta = \psi - \chi, \qquad
        \omega' = \omega + \frac{\Delta t}{T + \Delta t} \Big(\frac{\psi' - \psi}{\Delta t} - \omega\Big)

    ``psi`` is the heading of :class:`HeadingFrameTransform`, which turns within 2 cm, or at once along a wall that
    holds the tool up. The course ``chi`` (:func:`~ppt_rl.functional.heading.follow_course`) turns over a longer way. A
    heading that differs from it by more than a right angle points back to where the tool came from.

    State and observations: ``course`` ``(*B, 1)`` [rad] and ``turning`` ``(*B, 1)``, omega [rad/s].
    Observation: ``heading_memory`` ``(*B, 3)``: ``cos(delta)``, ``sin(delta)`` [-], ``omega`` [rad/s]; seen in a mirror,
    the second and the third change their sign. Append this transform at control rate, after the one that writes the
    heading.

    Args:
        distance: distance of travel over which the course turns [m].
        smoothing: T, time constant of the low-pass on the turning [s].
        dt: control step [s]; None takes it from the environment, and needs one.
        twist_key: measured twist.
        heading_key: heading of the tool.

    Raises:
        KeyError: if an observation is missing.
        ValueError: if a number is not positive.

    Source:
        Ours.
    """

    _at_control_rate = True
    state_keys = ("course", "turning", "course_heading")
    _hint = " HeadingFrameTransform writes heading."

    def __init__(
        self,
        distance: float = 0.08,
        *,
        smoothing: float = 0.15,
        dt: float | None = None,
        twist_key: NestedKey = "twist",
        heading_key: NestedKey = "heading",
    ) -> None:
        super().__init__(in_keys=[twist_key, heading_key], out_keys=["heading_memory"])
        self.distance = require_positive("distance", distance, "m")
        self.smoothing = require_positive("smoothing", smoothing, "s")
        self.dt = dt

    def _begin(self, *readings: Tensor) -> Entries:
        twist, heading = readings
        for key, value, size in zip(self.in_keys, readings, (6, 1), strict=True):
            require_last_dim(str(key), value, size)
        return {"course": heading, "turning": torch.zeros_like(heading), "course_heading": heading}

    def _update(self, state: Entries, *readings: Tensor) -> Entries:
        twist, heading = readings
        turned = _wrapped(heading - state["course_heading"]) / self.dt  # [rad/s]
        turning = state["turning"] + (turned - state["turning"]) * (self.dt / (self.smoothing + self.dt))
        course = follow_course(state["course"], twist[..., :2], dt=self.dt, distance=self.distance)
        return {"course": course, "turning": turning, "course_heading": heading}

    def _outputs(self, tensordict: TensorDictBase, state: Entries, *readings: Tensor) -> Entries:
        off = readings[1] - state["course"]
        return {"heading_memory": torch.cat([off.cos(), off.sin(), state["turning"]], -1)}

    def _state_specs(self, batch: torch.Size, like: TensorSpec) -> dict[NestedKey, TensorSpec]:
        return {key: real(like, *batch, 1) for key in self.state_keys}

    def _output_specs(self, batch: torch.Size, like: TensorSpec) -> dict[NestedKey, TensorSpec]:
        return {"heading_memory": real(like, *batch, 3)}


def _wrapped(angle: Tensor) -> Tensor:
    """The same angle between -pi and pi."""
    return torch.atan2(angle.sin(), angle.cos())
