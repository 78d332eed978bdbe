"""A hand-written wall follower: the baseline of the learnt maze policies."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor

from ppt_rl.functional.checks import require_positive
from ppt_rl.modules.task_space import TaskSpace

__all__ = ["WallFollower"]


class WallFollower:
    r"""Keeps the reference ahead of the tool along its heading and lightly below the floor; it learns nothing.

    .. math:: x_d = x + (l \cos\psi,\ l \sin\psi,\ -d), \qquad \dot x_d = v\,(\cos\psi, \sin\psi, 0)

    with the heading of :class:`~ppt_rl.transforms.HeadingFrameTransform`. It acts on references, behind an
    :class:`~ppt_rl.transforms.ImpedanceTransform`, at every control step.

    Args:
        task_space: task space with the coordinates x, y, z.
        lead: ``l``, distance of the reference ahead of the tool [m].
        speed: ``v`` [m/s].
        depth: ``d``, distance of the reference below the tool [m].
    """

    def __init__(
        self, task_space: TaskSpace, *, lead: float = 0.004, speed: float = 0.055, depth: float = 0.006
    ) -> None:
        self.task_space = task_space
        self.lead = require_positive("lead", lead, "m")
        self.speed = require_positive("speed", speed, "m/s")
        self.depth = require_positive("depth", depth, "m")

    def reference(self, pose: Tensor, heading: Tensor) -> tuple[Tensor, Tensor]:
        """Reference position and velocity.

        Args:
            pose: ``(*B, 7)`` of the tool [m, -].
            heading: ``(*B, 1)`` [rad].

        Returns:
            ``(*B, 3)`` position [m] and velocity [m/s].
        """
        direction = torch.cat([heading.cos(), heading.sin(), torch.zeros_like(heading)], -1)
        position = self.task_space.project(pose) + self.lead * direction
        position[..., 2] -= self.depth
        return position, self.speed * direction

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the reference as the action."""
        position, velocity = self.reference(tensordict["pose"], tensordict["heading"])
        reference = torch.cat([self.task_space.pose(position), self.task_space.twist(velocity)], -1)
        return tensordict.set("action", reference)
