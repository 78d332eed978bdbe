"""The difficulty of a task's episodes, one quantity at a time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

__all__ = ["Sweep", "SweepPoint"]


@dataclass(frozen=True)
class SweepPoint:
    """Episodes of one difficulty.

    Attributes:
        quantity: what is varied, with its unit.
        value: its value.
        given: the episodes, in the task's own form.
    """

    quantity: str
    value: float
    given: Sequence[Any]


@dataclass(frozen=True)
class Sweep:
    """The difficulty of a task's episodes.

    Attributes:
        points: makes the points from the number of episodes at each and a seed.
        usual: by quantity, its range in the test.
    """

    points: Callable[[int, int], list[SweepPoint]]
    usual: Mapping[str, tuple[float, float]]
