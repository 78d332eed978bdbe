"""The via-points of a reference push: approach the box, then push it to its goal."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ppt_rl.envs.limits import Bound, require_within

__all__ = ["PushReference", "push_via_points"]

_BOUNDS: dict[str, Bound] = {
    "counter_turn": (-3.0, 3.0, ""), "approach_yaw": (-2.0, 2.0, ""), "gap": (0.0, 0.2, "m"),
}  # fmt: skip


@dataclass(frozen=True)
class PushReference:
    """How the reference approaches the box.

    Attributes:
        counter_turn: share of the turn that the box still has to make by which the paddle approaches from the other
            side. It pushes beside the centre then, and so turns the box. Used only where a goal has a yaw [-].
        approach_yaw: yaw of the paddle behind the box, as a share of the heading of the approach. The box is roughly
            aligned with the table, so in an oblique push a paddle at right angles to the push would hit a corner [-].
        gap: distance between paddle and box at the via-point behind the box [m].

    Raises:
        ValueError: if a number is out of range.
    """

    counter_turn: float = 0.5
    approach_yaw: float = 0.7
    gap: float = 0.02

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name, bound in _BOUNDS.items():
            require_within(f"PushReference.{name}", getattr(self, name), bound)


def push_via_points(
    reference: PushReference, *, tool: Tensor, box: Tensor, goal: Tensor, goal_yaw: Tensor | None, offset: Tensor
) -> Tensor:
    r"""Via-points: where the tool is, behind the box, and touching the box at the goal.

    With the heading ``h`` of the push from box to goal, the paddle approaches along

    .. math:: h' = h - k\,(\theta - h)

    where ``theta`` is the yaw of the goal and ``k`` the counter turn; without a yaw, ``h' = h``.

    Args:
        reference: shape of the approach.
        tool: ``(B, 2)`` position of the tool [m].
        box: ``(B, 2)`` known position of the box's centre at the start [m].
        goal: ``(B, 2)`` goal of the box's centre [m].
        goal_yaw: ``(B, 1)`` goal of its yaw [rad]; None where any yaw will do.
        offset: ``(B, 1)`` distance from the box's centre to the middle of the paddle where they touch [m].

    Returns:
        ``(B, 3, 3)`` via-points (x, y, yaw) [m, rad].
    """
    push = goal - box
    heading = torch.atan2(push[:, 1:], push[:, :1])
    final = heading if goal_yaw is None else goal_yaw
    approach = heading - reference.counter_turn * (final - heading)
    start = torch.cat([tool, torch.zeros_like(heading)], -1)
    behind = torch.cat([box - (offset + reference.gap) * _direction(approach), reference.approach_yaw * approach], -1)
    end = torch.cat([goal - offset * _direction(final), final], -1)
    return torch.stack([start, behind, end], 1)


def _direction(heading: Tensor) -> Tensor:
    return torch.cat([heading.cos(), heading.sin()], -1)
