"""The difficulty of mazes: how sharp they turn, how wide they are, how much they rise, how much they rub."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ppt_rl.envs import MazeRanges, random_maze
from ppt_rl.evaluation import Sweep, SweepPoint

__all__ = ["MAZE_SWEEP"]

_USUAL = MazeRanges()


@dataclass(frozen=True)
class _Quantity:
    """What is varied: ranges of mazes from a value, the values, and the range of the test."""

    ranges: Callable[[float], MazeRanges]
    values: Sequence[float]
    usual: tuple[float, float]


def _turn(degrees: float) -> MazeRanges:
    return replace(_USUAL, turn=(math.radians(degrees),) * 2, length=(0.8, 1.1))


def _width(millimetres: float) -> MazeRanges:
    return replace(_USUAL, width=(1e-3 * millimetres,) * 2)


def _rise(centimetres: float) -> MazeRanges:
    return replace(_USUAL, rise=(1e-2 * centimetres,) * 2)


def _friction(friction: float) -> MazeRanges:
    return replace(_USUAL, friction=(friction, friction))


_QUANTITIES = {
    "turns [degrees]": _Quantity(_turn, (0, 15, 30, 45, 60, 75), (20, 45)),
    "width [mm]": _Quantity(_width, (30, 35, 40, 45, 50, 55, 60), (50, 60)),
    "rise [cm]": _Quantity(_rise, (0, 2, 4, 6, 8, 10), (1, 4)),
    "friction [-]": _Quantity(_friction, (0.1, 0.25, 0.4, 0.6, 0.8, 1.0), (0.1, 0.4)),
}


def _points(count: int, seed: int) -> list[SweepPoint]:
    """Mazes of every point; the n-th maze of all values is drawn from one seed."""
    return [
        SweepPoint(
            name, value, [random_maze(np.random.default_rng([seed, n]), quantity.ranges(value)) for n in range(count)]
        )
        for name, quantity in _QUANTITIES.items()
        for value in quantity.values
    ]


MAZE_SWEEP = Sweep(_points, {name: quantity.usual for name, quantity in _QUANTITIES.items()})
