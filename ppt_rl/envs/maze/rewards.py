"""The reward of maze sliding: one function per term, and their weights."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from ppt_rl.envs.limits import require_weights
from ppt_rl.functional.checks import require_positive

__all__ = ["MazeRewards", "arrival", "contact", "failure", "free_space", "progress"]


@dataclass(frozen=True)
class MazeRewards:
    """Weights of the reward terms; the function of the same name says what a term is for.

    Attributes:
        progress: reward for the whole length of the centre line [1].
        success: reward where the end is reached, see :func:`arrival` [1].
        free_space: penalty rate on a speed that differs from ``cruise`` by 100 % [1/s].
        cruise: wanted speed on the map [m/s].
        contact: penalty rate at a horizontal force of ``force_scale`` [1/s].
        force_scale: force at which the penalty rate is ``contact`` [N].
        jolt: penalty rate at an acceleration of 1 m/s^2 [1/s].
        failure: penalty where the tool leaves the corridor or the force is unsafe [1].
        power: penalty on measured work in either direction [1/J].

    Raises:
        ValueError: if a weight is no finite number, or ``cruise`` or ``force_scale`` is not positive.
    """

    progress: float = 1.0
    success: float = 1.0
    free_space: float = 20.0
    cruise: float = 0.0565
    contact: float = 12.0
    force_scale: float = 4.0
    jolt: float = 5.0
    failure: float = 2.0
    power: float = 0.1

    def __post_init__(self) -> None:
        """Check the numbers."""
        require_weights(self)
        require_positive("MazeRewards.cruise", self.cruise, "m/s")
        require_positive("MazeRewards.force_scale", self.force_scale, "N")


def progress(weights: MazeRewards, *, travelled: Tensor, previous: Tensor, length: Tensor) -> Tensor:
    r"""Progress of the tool in this control step: ``w (s - s_previous) / L``.

    The terms of an episode add up to the share of the centre line that the tool has covered. Going back and forth
    therefore earns nothing, and short and long mazes are worth the same.

    Args:
        weights: of the task.
        travelled: ``(B, 1)`` distance s along the centre line [m].
        previous: ``(B, 1)`` the same one control step before [m].
        length: ``(B, 1)`` length L of the centre line [m].

    Returns:
        ``(B, 1)`` reward, negative where the tool moves back.
    """
    return ((travelled - previous) / length) * weights.progress


def arrival(weights: MazeRewards, *, success: Tensor) -> Tensor:
    r"""Reward for reaching the open end: ``w_success [success]``.

    It makes the last millimetres worth more than the same distance anywhere else, and stopping short of the end costly.

    Args:
        weights: of the task.
        success: ``(B, 1)`` True where the end is reached in this control step.

    Returns:
        ``(B, 1)`` reward, zero or positive.
    """
    return weights.success * success


def free_space(weights: MazeRewards, *, speed: Tensor, dt: float) -> Tensor:
    r"""Penalty on hurry and on dawdling: ``-w (v / v_cruise - 1)^2 dt``.

    Training sees straight corridors only, in which the fastest policy would be the best. The cruising speed keeps a
    policy slow enough for a turn that it cannot foresee, and the square leaves small deviations free.

    Args:
        weights: of the task.
        speed: ``(B, 1)`` of the tool on the map [m/s].
        dt: control step [s].

    Returns:
        ``(B, 1)`` reward, zero or negative.
    """
    return (-weights.free_space * dt) * (speed / weights.cruise - 1).square()


def contact(weights: MazeRewards, *, force: Tensor, acceleration: Tensor, dt: float) -> Tensor:
    r"""Penalty on rough contact: ``-(w_contact |F|^2 / F_scale^2 + w_jolt |a|^2) dt``.

    Touch is the only source of information in a maze, so light contact must be cheap and hard contact expensive: hence
    the squares. The acceleration counts because an impact shows in it even where the force is small on average.

    Args:
        weights: of the task.
        force: ``(B, 2)`` on the map: the floor's support is not a cost [N].
        acceleration: ``(B, 3)`` of the tool [m/s^2].
        dt: control step [s].

    Returns:
        ``(B, 1)`` reward, zero or negative.
    """
    pressed = force.square().sum(-1, keepdim=True) / weights.force_scale**2
    jolted = acceleration.square().sum(-1, keepdim=True)
    return (weights.contact * pressed + weights.jolt * jolted) * -dt


def failure(weights: MazeRewards, *, failed: Tensor) -> Tensor:
    r"""Penalty for an unsafe end: ``-w_failure [failed]``.

    A failure ends the episode and with it all running penalties; without a price of its own it would be a way out.

    Args:
        weights: of the task.
        failed: ``(B, 1)`` True where the tool left the corridor or the force was unsafe.

    Returns:
        ``(B, 1)`` reward, zero or negative.
    """
    return -weights.failure * failed
