"""Mazes and straight corridors drawn at random, always such that they can be built."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ppt_rl.arms import PANDA, Arm
from ppt_rl.arms.arm import Limits
from ppt_rl.envs.maze.geometry import build_corridor, check_corridor
from ppt_rl.envs.maze.layout import Disc, MazeLayout, Segment, Straight, Turn

__all__ = ["MazeRanges", "StraightRanges", "random_maze", "random_straight"]

_TRIES = 2000


@dataclass(frozen=True)
class StraightRanges:
    """Ranges of the straight corridors of training, drawn from uniformly.

    Attributes:
        length: [m].
        width: [m].
        friction: of walls and floor on the tool [-].
        height: of the floor above the table [m].
        x: of the middle [m].
        y: of the middle [m].
    """

    length: tuple[float, float] = (0.16, 0.26)
    width: tuple[float, float] = (0.05, 0.06)
    friction: tuple[float, float] = (0.1, 0.4)
    height: tuple[float, float] = (0.0, 0.05)
    x: tuple[float, float] = (0.42, 0.58)
    y: tuple[float, float] = (-0.25, 0.25)

    def __post_init__(self) -> None:
        """Refuse empty ranges."""
        _require_ranges(self)


@dataclass(frozen=True)
class MazeRanges:
    """Ranges of the mazes of the test, drawn from uniformly (paper, section "Maze Sliding").

    Attributes:
        length: of all segments together, a disc with its diameter [m].
        width: [m].
        friction: of walls and floor on the tool [-].
        turn: size of a turn, to either side [rad].
        turns: number of turns, both ends included.
        rise: of each ramp; one goes up, a later one down [m].
        discs: number of discs, both ends included.
        disc: diameter of a disc [m].
        disc_angle: turn within a disc, to either side [rad].
    """

    length: tuple[float, float] = (0.9, 1.1)
    width: tuple[float, float] = (0.05, 0.06)
    friction: tuple[float, float] = (0.1, 0.4)
    turn: tuple[float, float] = (math.radians(20), math.radians(45))
    turns: tuple[int, int] = (3, 5)
    rise: tuple[float, float] = (0.01, 0.04)
    discs: tuple[int, int] = (1, 1)
    disc: tuple[float, float] = (0.08, 0.11)
    disc_angle: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        """Refuse empty ranges."""
        _require_ranges(self)


def _require_ranges(ranges: StraightRanges | MazeRanges) -> None:
    for name, (low, high) in vars(ranges).items():
        if not low <= high:
            raise ValueError(f"{type(ranges).__name__}.{name} is ({low}, {high}); expected low <= high.")


def random_straight(rng: np.random.Generator, ranges: StraightRanges | None = None, arm: Arm = PANDA) -> MazeLayout:
    """A straight corridor in a random place and direction. It cannot turn: it is one straight segment.

    Args:
        rng: source of randomness.
        ranges: what to draw from.
        arm: the arm, in whose reach it must lie.

    Returns:
        The layout, which can be built.

    Raises:
        ValueError: if nothing within the ranges fits into the arm's reach.
    """
    ranges = StraightRanges() if ranges is None else ranges
    for _ in range(_TRIES):
        length, heading = rng.uniform(*ranges.length), rng.uniform(-math.pi, math.pi)
        way = 0.5 * length * np.asarray([math.cos(heading), math.sin(heading)])
        start = np.asarray([rng.uniform(*ranges.x), rng.uniform(*ranges.y)]) - way
        layout = MazeLayout(
            (Straight(length),),
            width=rng.uniform(*ranges.width),
            friction=rng.uniform(*ranges.friction),
            start=(float(start[0]), float(start[1])),
            heading=heading,
            height=rng.uniform(*ranges.height),
        )
        if _can_be_built(layout, arm.reach):
            return layout
    raise ValueError(f"no straight corridor within {ranges} fits into the arm's reach; widen the ranges.")


def random_maze(rng: np.random.Generator, ranges: MazeRanges | None = None, arm: Arm = PANDA) -> MazeLayout:
    """A maze with turns, ramps up and down and discs in random order and place.

    Args:
        rng: source of randomness.
        ranges: what to draw from.
        arm: the arm, in whose reach it must lie.

    Returns:
        The layout, which can be built.

    Raises:
        ValueError: if nothing within the ranges fits into the arm's reach.
    """
    ranges = MazeRanges() if ranges is None else ranges
    for _ in range(_TRIES):
        layout = _candidate(rng, ranges)
        if layout is not None and _can_be_built(layout, arm.reach):
            return layout
    raise ValueError(f"no maze within {ranges} fits into the arm's reach; widen the ranges, or make it shorter.")


def _candidate(rng: np.random.Generator, ranges: MazeRanges) -> MazeLayout | None:
    """Corners in random order, straights between them of random share in the length, two of them ramps."""
    turns, discs = (int(rng.integers(low, high + 1)) for low, high in (ranges.turns, ranges.discs))
    corners: list[Segment] = [Turn(_signed(rng, ranges.turn)) for _ in range(turns)]
    corners += [Disc(rng.uniform(*ranges.disc), _signed(rng, ranges.disc_angle)) for _ in range(discs)]
    corners = [corners[i] for i in rng.permutation(len(corners))]
    count = len(corners) + 1
    ramps = rng.choice(count, size=min(2, count), replace=False)
    up, down = int(ramps.min()), int(ramps.max())
    rise = rng.uniform(*ranges.rise)
    rises = {up: rise, down: -rise} if up != down else {}
    # A ramp needs level ends and a run; what is left of the length goes to the straights by random shares.
    least = np.full(count, 0.06)
    for i, height in rises.items():
        least[i] = 0.07 + abs(height) / math.tan(math.radians(20))
    chambers = sum(corner.diameter for corner in corners if isinstance(corner, Disc))
    spare = rng.uniform(*ranges.length) - chambers - least.sum()
    if spare < 0:
        return None
    lengths = least + spare * rng.dirichlet(np.full(count, 3.0))
    segments: list[Segment] = [Straight(float(lengths[0]), rises.get(0, 0.0))]
    for i, corner in enumerate(corners, start=1):
        segments += [corner, Straight(float(lengths[i]), rises.get(i, 0.0))]
    turned = sum(corner.angle for corner in corners if not isinstance(corner, Straight))
    side = rng.choice((-1.0, 1.0))  # from the right to the left of the robot, or back
    heading = side * (math.pi / 2) - 0.5 * turned + rng.uniform(-0.4, 0.4)
    return MazeLayout(
        tuple(segments),
        width=rng.uniform(*ranges.width),
        friction=rng.uniform(*ranges.friction),
        start=(rng.uniform(0.35, 0.60), float(-side * rng.uniform(0.28, 0.48))),
        heading=heading,
        height=0.0,
    )


def _signed(rng: np.random.Generator, sizes: tuple[float, float]) -> float:
    return float(rng.choice((-1.0, 1.0)) * rng.uniform(*sizes))


def _can_be_built(layout: MazeLayout, reach: Limits) -> bool:
    try:
        check_corridor(build_corridor(layout), layout, reach)
    except ValueError:
        return False
    return True
