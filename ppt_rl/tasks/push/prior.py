"""Scripted demonstrations of pushing, and the prior of the movement primitive that is fitted to them."""

from __future__ import annotations

import torch
from torch import Tensor

from ppt_rl.envs.physics import EngineConfig
from ppt_rl.envs.push import PushEnv, PushGoal, PushReference
from ppt_rl.modules.promp import ProMP

__all__ = ["PUSH_AXES", "fit_push_prior", "minimum_jerk", "push_demonstrations"]

#: Task-space coordinates of the pushing primitive.
PUSH_AXES = ("x", "y", "yaw")


def minimum_jerk(phase: Tensor) -> Tensor:
    """Minimum-jerk profile from rest to rest, ``10 s^3 - 15 s^4 + 6 s^5``, clamped outside [0, 1].

    Args:
        phase: ``(*B,)`` [-].

    Returns:
        ``(*B,)`` in [0, 1].
    """
    s = phase.clamp(0.0, 1.0)
    return s**3 * (10 + s * (6 * s - 15))


def push_demonstrations(via_phase: Tensor, via_position: Tensor, num_samples: int = 151) -> Tensor:
    """Approach, then push: minimum-jerk motions from one via-point to the next, at their phases.

    Args:
        via_phase: ``(N, M)`` increasing phases.
        via_position: ``(N, M, D)`` coordinates.
        num_samples: number of samples over phase 0 to 1.

    Returns:
        ``(N, num_samples, D)`` trajectories.
    """
    phase = torch.linspace(0.0, 1.0, num_samples, dtype=via_position.dtype)
    begin, end = via_phase[:, :-1, None], via_phase[:, 1:, None]
    profile = minimum_jerk((phase - begin) / (end - begin))  # (N, M - 1, T)
    steps = via_position.diff(dim=1)  # (N, M - 1, D)
    return via_position[:, :1] + profile.mT @ steps


def fit_push_prior(
    promp: ProMP,
    *,
    goal: PushGoal = "position",
    counter_turn: float = 0.5,
    num_demonstrations: int = 512,
    seed: int = 0,
) -> ProMP:
    """Fit the prior of a pushing primitive to scripted demonstrations of random episodes.

    Args:
        promp: a primitive with the coordinates of :data:`PUSH_AXES`; changed in place.
        goal: what has to be at the goal.
        counter_turn: as in :class:`~ppt_rl.envs.PushReference`.
        num_demonstrations: number of episodes.
        seed: seed of the episodes.

    Returns:
        The primitive.
    """
    engine = EngineConfig(num_threads=1)
    reference = PushReference(counter_turn=counter_turn)
    env = PushEnv(
        num_envs=num_demonstrations, goal=goal, reference=reference, duration=promp.duration, seed=seed, engine=engine
    )
    episode = env.reset()
    promp.fit(push_demonstrations(episode["via_phase"].double(), episode["via_position"].double()))
    env.close()
    return promp
