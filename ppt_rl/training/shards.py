"""Work on the rows of a batch, spread over the CPUs without a thread that spins while it waits."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

import torch
from torch import Tensor

__all__ = ["Shards"]

_Result = TypeVar("_Result")
#: Least number of rows that a thread is worth.
_LEAST = 512


class Shards:
    """Runs a function on parts of some rows, each part in a thread in which torch uses one CPU.

    torch's own threads split every operation and meet after each. One that waits spins, which takes the CPU from the
    one it waits for where another process runs beside: an update then takes up to 28 times as long. These threads meet
    once, and wait without a CPU. The number of parts follows from the numbers of rows and threads alone, so the same
    batch gives the same result.

    Args:
        threads: largest number of threads; None takes one for each CPU that this process may use.
    """

    def __init__(self, threads: int | None = None) -> None:
        self.threads = threads or len(os.sched_getaffinity(0))
        self._pool: ThreadPoolExecutor | None = None

    def count(self, rows: Tensor) -> int:
        """Number of parts for some rows: one on a GPU, and as many on the CPU as have enough to do.

        Args:
            rows: ``(n,)`` indices.

        Returns:
            The number.
        """
        return 1 if rows.device.type != "cpu" else max(1, min(self.threads, len(rows) // _LEAST))

    def __call__(self, work: Callable[[Tensor], _Result], rows: Tensor) -> list[_Result]:
        """Run a function on every part.

        Args:
            work: of the indices of a part.
            rows: ``(n,)`` indices.

        Returns:
            What it returned for each part, in their order.
        """
        first, *others = rows.tensor_split(self.count(rows))
        running = [self._workers().submit(work, part) for part in others]
        return [work(first), *(each.result() for each in running)]

    def _workers(self) -> ThreadPoolExecutor:
        if self._pool is None:
            self._pool = ThreadPoolExecutor(
                self.threads - 1, "update", initializer=torch.set_num_threads, initargs=(1,)
            )
        return self._pool

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Let torch use one CPU in this thread too, as in the others."""
        before = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            yield
        finally:
            torch.set_num_threads(before)
