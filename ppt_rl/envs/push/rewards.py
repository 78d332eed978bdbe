"""The reward of box pushing: one function per term, and their weights."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ppt_rl.envs.limits import require_weights
from ppt_rl.functional.argument_checks import require_in_range
from ppt_rl.functional.constants import constant

__all__ = ["PushRewards", "arrival", "contact", "free_space", "pose_arrival", "progress", "turn"]

#: Widths of the reward for the pose at the end [m], [rad].
_POSE_RADIUS, _POSE_YAW = 0.06, 0.2


@dataclass(frozen=True)
class PushRewards:
    """Weights of the reward terms; the function of the same name says what a term is for.

    Attributes:
        progress: reward for moving the box all the way from its start to the goal [1].
        precision: largest reward at the end for a box near the goal, see :func:`arrival` [1].
        success: reward at the end if the task is done [1].
        turn: reward for turning the box towards the yaw of its goal, where it has one [1/rad].
        pose: largest reward at the end for a box near the pose of its goal, see :func:`pose_arrival` [1].
        free_space: reward for moving the tool all the way from its start to the box [1].
        contact: penalty on contact force above ``force_limit`` [1/(N s)].
        force_limit: contact force that costs nothing [N].
        power: penalty on measured work in either direction [1/J].

    Raises:
        ValueError: if a weight is no finite number, or the limit is negative.
    """

    progress: float = 1.0
    precision: float = 1.0
    success: float = 1.0
    turn: float = 0.5
    pose: float = 1.0
    free_space: float = 0.2
    contact: float = 0.2
    force_limit: float = 5.0
    power: float = 0.1

    def __post_init__(self) -> None:
        """Check the numbers."""
        require_weights(self)
        require_in_range("PushRewards.force_limit", self.force_limit, 0.0, unit="N")


def progress(weights: PushRewards, *, distance: Tensor, previous: Tensor, initial: Tensor) -> Tensor:
    r"""Progress of the box in this control step: ``w (d_previous - d) / d_initial``.

    The terms of an episode add up to the share of the distance that the box has covered. Pushing it away and back
    therefore earns nothing, and near and far goals are worth the same.

    Args:
        weights: of the task.
        distance: ``(B, 1)`` from box to goal [m].
        previous: ``(B, 1)`` the same one control step before [m].
        initial: ``(B, 1)`` the same at the start of the episode [m].

    Returns:
        ``(B, 1)`` reward, negative where the box moves away from the goal.
    """
    return constant(weights.progress, distance) * ((previous - distance) / initial)


def arrival(weights: PushRewards, *, distance: Tensor, success: Tensor, ended: Tensor, radius: float) -> Tensor:
    r"""Reward at the end of the episode: ``w_precision exp(-d / r) + w_success [success]``; zero before.

    Success alone gives no gradient inside or outside its radius; the exponential also rewards coming closer.

    Args:
        weights: of the task.
        distance: ``(B, 1)`` from box to goal [m].
        success: ``(B, 1)`` True where the task is done.
        ended: ``(B, 1)`` True at the last control step of an episode.
        radius: success radius r [m].

    Returns:
        ``(B, 1)`` reward, zero or positive.
    """
    return (weights.precision * torch.exp(-distance / radius) + weights.success * success) * ended


def turn(weights: PushRewards, *, error: Tensor, previous: Tensor) -> Tensor:
    r"""Progress of the box's yaw in this control step: ``w (e_previous - e)``.

    Args:
        weights: of the task.
        error: ``(B, 1)`` size of the difference in yaw between box and goal [rad].
        previous: ``(B, 1)`` the same one control step before [rad].

    Returns:
        ``(B, 1)`` reward, negative where the box turns away from the yaw of its goal.
    """
    return constant(weights.turn, error) * (previous - error)


def pose_arrival(weights: PushRewards, *, distance: Tensor, error: Tensor, ended: Tensor) -> Tensor:
    r"""Reward at the end of the episode for position and yaw together: ``w exp(-d / 6 cm) exp(-e / 0.2 rad)``.

    It is three times as wide as the success radius, so a box that is turned well but not yet near earns something.

    Args:
        weights: of the task.
        distance: ``(B, 1)`` from box to goal [m].
        error: ``(B, 1)`` size of the difference in yaw [rad].
        ended: ``(B, 1)`` True at the last control step of an episode.

    Returns:
        ``(B, 1)`` reward, zero or positive.
    """
    return weights.pose * torch.exp(-distance / _POSE_RADIUS - error / _POSE_YAW) * ended


def free_space(weights: PushRewards, *, distance: Tensor, previous: Tensor, initial: Tensor, touched: Tensor) -> Tensor:
    r"""Approach of the tool in this control step: ``w (d_previous - d) / d_initial`` until the box is first touched.

    It leads an untrained policy to the box. It ends with the first touch, so that a tool that has to move back and push
    from another side pays nothing for that.

    Args:
        weights: of the task.
        distance: ``(B, 1)`` from tool to box [m].
        previous: ``(B, 1)`` the same one control step before [m].
        initial: ``(B, 1)`` the same at the start of the episode [m].
        touched: ``(B, 1)`` True where the tool has moved the box before this step.

    Returns:
        ``(B, 1)`` reward, negative where the tool moves away from the box.
    """
    return constant(weights.free_space, distance) * ((previous - distance) / initial) * ~touched


def contact(weights: PushRewards, *, force: Tensor, dt: float) -> Tensor:
    r"""Penalty on large contact force: ``-w max(0, F - F_limit) dt``.

    Pushing needs some force, so force is free up to the limit. Above it, impacts and pressing into the table cost.

    Args:
        weights: of the task.
        force: ``(B, 1)`` size of the contact force [N].
        dt: control step [s].

    Returns:
        ``(B, 1)`` reward, zero or negative.
    """
    excess = (force - constant(weights.force_limit, force)).clamp_min(0.0)
    return constant(-weights.contact * dt, force) * excess
