"""Work on the rows of a batch, spread over the CPUs without a thread that spins while it waits."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

import torch

__all__ = ["Shards"]

_Result = TypeVar("_Result")
#: Rows of a part: enough for the work to outweigh what a call costs.
_ROWS = 1024


class Shards:
    """Runs tasks, such as the parts of a batch, in threads in which torch uses one CPU each.

    torch's own threads split every operation and meet after each. One that waits spins, which takes the CPU from the
    one it waits for where another process runs beside: an update then takes up to 28 times as long. These threads meet
    once, and wait without a CPU. What the parts are follows from the number of rows alone, so the number of threads
    changes no result.

    Args:
        threads: number of threads; None takes one for each CPU that this process may use.
    """

    def __init__(self, threads: int | None = None) -> None:
        self.threads = threads or len(os.sched_getaffinity(0))
        self._pool: ThreadPoolExecutor | None = None

    @staticmethod
    def count(rows: int, device: torch.device) -> int:
        """Number of parts for some rows: one for about 1,024 of them.

        Args:
            rows: their number.
            device: where they are. On a GPU they are one part.

        Returns:
            At least one.
        """
        return max(1, round(rows / _ROWS)) if device.type == "cpu" else 1

    def run(self, tasks: Sequence[Callable[[], _Result]]) -> list[_Result]:
        """Run some tasks.

        Args:
            tasks: functions that do not wait for each other.

        Returns:
            What each of them returned, in their order.
        """
        threads = min(self.threads, len(tasks))
        if threads == 1:
            return [task() for task in tasks]
        # Thread k takes the tasks k, k + threads, k + 2 threads and so on; this one is thread 0.
        running = [self._workers().submit(_each, tasks[number::threads]) for number in range(1, threads)]
        done = [_each(tasks[::threads]), *(each.result() for each in running)]
        return [done[number % threads][number // threads] for number in range(len(tasks))]

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


def _each(tasks: Sequence[Callable[[], _Result]]) -> list[_Result]:
    return [task() for task in tasks]
