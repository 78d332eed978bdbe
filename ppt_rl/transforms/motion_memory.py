"""What a sliding tool remembers of its motion, in heading axes."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import TensorSpec

from ppt_rl.functional.checks import require_last_dim, require_positive
from ppt_rl.functional.heading import to_heading
from ppt_rl.functional.motion import follow_course, follow_creep
from ppt_rl.transforms.base import Entries
from ppt_rl.transforms.observer import ObserverTransform
from ppt_rl.transforms.specs import real
from ppt_rl.transforms.timed import TimedTransform

__all__ = ["MotionMemoryTransform"]


class MotionMemoryTransform(TimedTransform, ObserverTransform):
    r"""Lets a policy see which way a stuck tool creeps, and where it came from.

    .. math:: c_h = R_z(-\psi)\, \frac{c}{|c| + r}, \qquad u_h = R_z(-\psi)\, u

    with the creep ``c`` of :func:`~ppt_rl.functional.motion.follow_creep`, the course ``u`` of
    :func:`~ppt_rl.functional.motion.follow_course`, and the heading ``psi``. A policy without a memory cannot know
    either: the velocity of a tool that sticks is lost beside that of one that moves, and its heading turns while it is
    stuck. Append this transform at control rate, after a :class:`HeadingFrameTransform`.

    State: ``creep`` ``(*B, 2)`` [m] and ``course`` ``(*B, 2)`` [-], world axes. An episode starts without creep, on the
    course of its heading. Observations: ``heading_creep`` and ``heading_course`` ``(*B, 2)``, axes ahead and left [-];
    the former is as long as one half at a creep of ``r``.

    Args:
        slow: a slower tool is held up, one that is twice as fast is free [m/s].
        memory: time in which creep is forgotten [s].
        distance: distance of travel in which the course is forgotten [m].
        reach: r, creep at which the observation is as long as one half [m].
        dt: control step [s]; None takes it from the environment, and needs one.
        twist_key: measured twist.
        heading_key: heading of the tool, as :class:`HeadingFrameTransform` writes it.

    Raises:
        KeyError: if an observation is missing.
        ValueError: if a number is not positive.

    Source:
        Ours.
    """

    _at_control_rate = True
    state_keys = ("creep", "course")
    _hint = " HeadingFrameTransform writes heading."

    def __init__(
        self,
        *,
        slow: float = 0.03,
        memory: float = 0.4,
        distance: float = 0.08,
        reach: float = 0.001,
        dt: float | None = None,
        twist_key: NestedKey = "twist",
        heading_key: NestedKey = "heading",
    ) -> None:
        super().__init__(in_keys=[twist_key, heading_key], out_keys=["heading_creep", "heading_course"])
        self.slow = require_positive("slow", slow, "m/s")
        self.memory = require_positive("memory", memory, "s")
        self.distance = require_positive("distance", distance, "m")
        self.reach = require_positive("reach", reach, "m")
        self.dt = dt

    def _begin(self, *readings: Tensor) -> Entries:
        twist, heading = readings
        for key, value, size in zip(self.in_keys, readings, (6, 1), strict=True):
            require_last_dim(str(key), value, size)
        return {"creep": torch.zeros_like(twist[..., :2]), "course": torch.cat([heading.cos(), heading.sin()], -1)}

    def _update(self, state: Entries, *readings: Tensor) -> Entries:
        velocity = readings[0][..., :2]
        return {
            "creep": follow_creep(state["creep"], velocity, dt=self.dt, slow=self.slow, memory=self.memory),
            "course": follow_course(state["course"], velocity, dt=self.dt, distance=self.distance),
        }

    def _outputs(self, tensordict: TensorDictBase, state: Entries, *readings: Tensor) -> Entries:
        creep, heading = state["creep"], readings[1]
        shown = creep / (torch.linalg.vector_norm(creep, dim=-1, keepdim=True) + self.reach)
        vectors = dict(zip(self.out_keys, (shown, state["course"]), strict=True))
        flat = torch.zeros_like(heading)
        return {key: to_heading(torch.cat([value, flat], -1), heading)[..., :2] for key, value in vectors.items()}

    def _state_specs(self, batch: torch.Size, like: TensorSpec) -> dict[NestedKey, TensorSpec]:
        return {key: real(like, *batch, 2) for key in self.state_keys}

    def _output_specs(self, batch: torch.Size, like: TensorSpec) -> dict[NestedKey, TensorSpec]:
        return {key: real(like, *batch, 2) for key in self.out_keys}
