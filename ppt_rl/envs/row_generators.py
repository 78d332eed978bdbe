"""Random numbers of a batch of environments, a generator for each."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

__all__ = ["RowGenerators"]


class RowGenerators:
    """A random generator for each environment, seeded by seed, stream and row.

    What an environment draws depends on its own row and on how often it drew before, not on how many others there are.
    So the episode of row 817 can be repeated alone, by an environment whose first row is 817.

    Args:
        seed: seed of the batch, at least 0.
        num_envs: number of environments.
        stream: streams draw different numbers from the same seed.
        first_row: row of the first environment.

    Raises:
        ValueError: if the seed is negative.
    """

    def __init__(self, seed: int, num_envs: int, *, stream: int = 0, first_row: int = 0) -> None:
        if seed < 0:
            raise ValueError(f"seed is {seed}; expected a whole number of at least 0.")
        rows = range(first_row, first_row + num_envs)
        self._generators = [np.random.default_rng([seed, stream, row]) for row in rows]

    def __getitem__(self, row: int) -> np.random.Generator:
        """The generator of an environment."""
        return self._generators[row]

    def uniform(self, rows: Iterable[int], count: int) -> np.ndarray:
        """Draw numbers from [0, 1) for some environments.

        Args:
            rows: ``(R,)`` their indices.
            count: how many numbers each draws.

        Returns:
            ``(R, count)`` numbers.
        """
        return np.stack([self._generators[row].random(count) for row in rows])
