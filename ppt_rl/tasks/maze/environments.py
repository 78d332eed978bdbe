"""Where maze policies train, and where they are judged."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ppt_rl.envs import MazeEnv, MazeLayout, MazeRandomisation
from ppt_rl.tasks.config import env_settings
from ppt_rl.tasks.maze.config import MazeConfig

#: Training mazes have seeds from here on, test mazes have smaller ones.
_TRAINING_SEEDS = 1_000_000_000

__all__ = ["make_test_env", "make_training_env"]


def make_training_env(
    config: MazeConfig, *, num_envs: int, seed: int | None = None, audit: bool = False, given: Sequence[Any] = ()
) -> MazeEnv:
    """Straight corridors to train in, or with ``config.train_in="mazes"`` random mazes.

    ``config``, ``num_envs``, ``seed`` and ``audit`` are those of :class:`~ppt_rl.evaluation.make_env.MakeEnv`;
    ``given`` must be empty, since both are drawn. Mazes are drawn from seeds that no test takes.

    Raises:
        ValueError: if mazes are given.
    """
    if given:
        raise ValueError(f"{len(given)} mazes are given; expected none, since training corridors are drawn.")
    in_mazes = config.train_in == "mazes"
    apart = None if seed is None else seed + _TRAINING_SEEDS * in_mazes
    settings = env_settings(config, num_envs=num_envs, seed=apart, audit=audit)
    settings |= {"duration": config.training_duration, "rewards": config.rewards}
    if in_mazes:
        return MazeEnv.mazes(ranges=config.mazes, **settings)
    told = MazeRandomisation(heading_error=(-config.heading_error, config.heading_error))
    return MazeEnv.straight(ranges=config.corridors, randomisation=told, **settings)


def make_test_env(
    config: MazeConfig, *, num_envs: int, seed: int | None = None, audit: bool = False, given: Sequence[MazeLayout] = ()
) -> MazeEnv:
    """Random mazes to be judged in, those of the files ``config.layouts``, or ``given`` ones, which are taken in turn.

    ``num_envs``, ``seed`` and ``audit`` are those of :class:`~ppt_rl.evaluation.make_env.MakeEnv`.

    Raises:
        ValueError: if a maze cannot be built.
    """
    settings = env_settings(config, num_envs=num_envs, seed=seed, audit=audit)
    layouts = given or [MazeLayout.load(path) for path in config.layouts]
    if layouts:
        return MazeEnv.of(layouts, duration=config.duration, rewards=config.rewards, **settings)
    return MazeEnv.mazes(ranges=config.mazes, duration=config.duration, rewards=config.rewards, **settings)
