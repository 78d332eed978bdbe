"""Random numbers of a batch of environments, a generator for each."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

__all__ = ["RowGenerators"]


#: Episodes of each environment for which numbers are drawn ahead.
_AHEAD = 16


class RowGenerators:
    """A random generator for each environment, seeded by seed, stream and row.

    What an environment draws depends on its own row and on how often it drew before, not on how many others there are.
    So the episode of row 817 can be repeated alone, by an environment whose first row is 817.

    Args:
        seed: seed of the batch, at least 0.
        num_envs: number of environments.
        stream: streams draw different numbers from the same seed.
        first_row: row of the first environment.
        device: where uniform numbers are needed. Elsewhere than on the CPU those of several episodes are drawn ahead.

    Raises:
        ValueError: if the seed is negative.
    """

    def __init__(
        self, seed: int, num_envs: int, *, stream: int = 0, first_row: int = 0, device: torch.device | None = None
    ) -> None:
        if seed < 0:
            raise ValueError(f"seed is {seed}; expected a whole number of at least 0.")
        rows = range(first_row, first_row + num_envs)
        self._generators = [np.random.default_rng([seed, stream, row]) for row in rows]
        self._device = torch.device("cpu") if device is None else device
        self.draws_ahead = self._device.type != "cpu"
        # Numbers drawn ahead (num_envs, episodes, count), and how many episodes each environment has begun with them:
        # at most as many as there were calls. At first all are used up.
        self._ahead = torch.empty(num_envs, 0, 0, dtype=torch.float64)
        self._used = torch.full((num_envs,), _AHEAD, device=self._device)
        self._calls = _AHEAD

    def __getitem__(self, row: int) -> np.random.Generator:
        """The generator of an environment."""
        return self._generators[row]

    def uniform(self, rows: Tensor, count: int) -> Tensor:
        """Draw numbers from [0, 1) for the next episode of some environments.

        Args:
            rows: ``(R,)`` their indices.
            count: how many numbers each draws, the same at every call.

        Returns:
            ``(R, count)`` numbers, in double precision.
        """
        if not self.draws_ahead:
            return torch.from_numpy(np.stack([self._generators[row].random(count) for row in rows.tolist()]))
        if self._calls == _AHEAD:
            self._draw_ahead(count)
        self._calls += 1
        drawn = self._ahead[rows, self._used[rows]]
        self._used[rows] += 1
        return drawn

    def _draw_ahead(self, count: int) -> None:
        """Draw numbers for as many episodes as can begin until the next time, in the order of each generator."""
        table = np.empty((len(self._generators), _AHEAD, count))
        unused = self._ahead.cpu().numpy()
        for row, used in enumerate(self._used.tolist()):
            left = _AHEAD - used
            table[row, :left] = unused[row, used:] if left else 0.0
            table[row, left:] = self._generators[row].random((used, count))
        self._ahead = torch.from_numpy(table).to(self._device)
        self._used = torch.zeros_like(self._used)
        self._calls = 0
