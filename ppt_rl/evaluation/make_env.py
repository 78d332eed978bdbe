"""How a task makes its bare environment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from ppt_rl.envs import ArmEnv

__all__ = ["MakeEnv"]


class MakeEnv(Protocol):
    """Makes the bare environment of a task, without the transforms of a recipe."""

    def __call__(
        self, config: Any, *, num_envs: int, seed: int | None, audit: bool, given: Sequence[Any] = ()
    ) -> ArmEnv:
        """Make an environment.

        Args:
            config: options of the recipe.
            num_envs: number of environments that step together.
            seed: seed of the episodes; None draws one.
            audit: whether power and work are measured at the rate of the physics.
            given: episodes to run in turn, in the task's own form (mazes), instead of random ones.

        Returns:
            The environment.
        """
        ...
