"""Random mazes and straight corridors that the arm can reach and drive through."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ppt_rl.arms import PANDA, Arm
from ppt_rl.envs.limits import Bound, require_bounded_ranges
from ppt_rl.envs.maze.feasibility import check_corridor
from ppt_rl.envs.maze.geometry import build_corridor
from ppt_rl.envs.maze.layout import Disc, MazeLayout, Segment, Straight, Turn
from ppt_rl.functional.argument_checks import require_instance

__all__ = ["MazeRanges", "StraightRanges", "random_maze", "random_straight"]

#: Layouts that are drawn before the ranges count as impossible.
_TRIES = 2000
#: What corridors and their parts can be at all.
_CORRIDOR: dict[str, Bound] = {"length": (0.02, 2.0, "m"), "width": (0.03, 0.2, "m"), "friction": (0.0, 1.0, "")}
_STRAIGHT = _CORRIDOR | {"height": (0.0, 0.2, "m"), "x": (-2.0, 2.0, "m"), "y": (-2.0, 2.0, "m")}
_MAZE = _CORRIDOR | {
    "turn": (0.0, math.radians(75), "rad"), "turns": (0, 20, ""), "rise": (0.0, 0.1, "m"), "discs": (0, 10, ""),
    "disc": (0.07, 0.3, "m"), "disc_angle": (0.0, math.radians(60), "rad"),
}  # fmt: skip


@dataclass(frozen=True)
class StraightRanges:
    """Ranges of the straight corridors used for training; each quantity is drawn uniformly.

    Attributes:
        length: length of the corridor [m].
        width: distance between the walls [m].
        friction: friction coefficient between the tool and walls or floor [-].
        height: height of the floor above the table [m].
        x: x of the corridor's middle [m].
        y: y of the corridor's middle [m].
    """

    length: tuple[float, float] = (0.16, 0.26)
    width: tuple[float, float] = (0.05, 0.06)
    friction: tuple[float, float] = (0.1, 0.4)
    height: tuple[float, float] = (0.0, 0.05)
    x: tuple[float, float] = (0.42, 0.58)
    y: tuple[float, float] = (-0.25, 0.25)

    def __post_init__(self) -> None:
        """Check that no range is empty or beyond what a corridor can be."""
        require_bounded_ranges(self, _STRAIGHT)


@dataclass(frozen=True)
class MazeRanges:
    """Ranges of the mazes used for testing; each quantity is drawn uniformly.

    Attributes:
        length: total length of the segments; a disc counts with its diameter [m].
        width: distance between the walls [m].
        friction: friction coefficient between the tool and walls or floor [-].
        turn: angle of a turn, to the left or to the right [rad].
        turns: number of turns, bounds included.
        rise: height of the two ramps, of which the first leads up and the second down [m].
        discs: number of discs, bounds included.
        disc: diameter of a disc [m].
        disc_angle: change of direction in a disc, to the left or to the right [rad].

    Source:
        Paper, section "Maze Sliding".
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
        """Check that no range is empty or beyond what a maze can be."""
        require_bounded_ranges(self, _MAZE)
        for name, counts in (("turns", self.turns), ("discs", self.discs)):
            if any(int(count) != count for count in counts):
                raise ValueError(f"MazeRanges.{name} is {counts}; expected whole numbers.")


def random_straight(rng: np.random.Generator, ranges: StraightRanges | None = None, arm: Arm = PANDA) -> MazeLayout:
    """Draw a straight corridor with a random position and direction; it consists of one straight segment.

    Args:
        rng: source of randomness.
        ranges: ranges to draw from; None takes the defaults.
        arm: the arm that must reach the corridor.

    Returns:
        A layout that passes :func:`~ppt_rl.envs.maze.feasibility.check_corridor`.

    Raises:
        ValueError: if an argument is of another type, or nothing within the ranges fits into the arm's reach.
    """
    ranges = StraightRanges() if ranges is None else ranges
    require_instance("rng", rng, np.random.Generator)
    require_instance("ranges", ranges, StraightRanges)
    require_instance("arm", arm, Arm)
    return _first_feasible(lambda: _draw_straight(rng, ranges), arm, ranges)


def random_maze(rng: np.random.Generator, ranges: MazeRanges | None = None, arm: Arm = PANDA) -> MazeLayout:
    """Draw a maze with turns, discs, a ramp up and a ramp down in random order.

    Args:
        rng: source of randomness.
        ranges: ranges to draw from; None takes the defaults.
        arm: the arm that must reach the maze.

    Returns:
        A layout that passes :func:`~ppt_rl.envs.maze.feasibility.check_corridor`.

    Raises:
        ValueError: if an argument is of another type, or nothing within the ranges fits into the arm's reach.
    """
    ranges = MazeRanges() if ranges is None else ranges
    require_instance("rng", rng, np.random.Generator)
    require_instance("ranges", ranges, MazeRanges)
    require_instance("arm", arm, Arm)
    return _first_feasible(lambda: _draw_maze(rng, ranges), arm, ranges)


def _first_feasible(draw: Callable[[], MazeLayout | None], arm: Arm, ranges: StraightRanges | MazeRanges) -> MazeLayout:
    """Draw layouts until one is feasible."""
    for _ in range(_TRIES):
        layout = draw()
        if layout is not None and _is_feasible(layout, arm):
            return layout
    raise ValueError(
        f"none of {_TRIES} layouts within {ranges} fits into the reach of {arm.name}; widen the ranges, or reduce the "
        "length."
    )


def _is_feasible(layout: MazeLayout, arm: Arm) -> bool:
    try:
        check_corridor(build_corridor(layout), layout, arm.reach)
    except ValueError:
        return False
    return True


def _draw_straight(rng: np.random.Generator, ranges: StraightRanges) -> MazeLayout:
    length, heading = rng.uniform(*ranges.length), rng.uniform(-math.pi, math.pi)
    half = 0.5 * length * np.asarray([math.cos(heading), math.sin(heading)])
    start = np.asarray([rng.uniform(*ranges.x), rng.uniform(*ranges.y)]) - half
    return MazeLayout(
        (Straight(length),),
        width=rng.uniform(*ranges.width),
        friction=rng.uniform(*ranges.friction),
        start=(float(start[0]), float(start[1])),
        heading=heading,
        height=rng.uniform(*ranges.height),
    )


def _draw_maze(rng: np.random.Generator, ranges: MazeRanges) -> MazeLayout | None:
    """Turns and discs in random order, with straights of random length between them, of which two are ramps.

    None if the straights would be too short.
    """
    turns, discs = (int(rng.integers(low, high + 1)) for low, high in (ranges.turns, ranges.discs))
    corners: list[Segment] = [Turn(_signed(rng, ranges.turn)) for _ in range(turns)]
    corners += [Disc(rng.uniform(*ranges.disc), _signed(rng, ranges.disc_angle)) for _ in range(discs)]
    corners = [corners[i] for i in rng.permutation(len(corners))]
    count = len(corners) + 1
    ramps = rng.choice(count, size=min(2, count), replace=False)
    up, down = int(ramps.min()), int(ramps.max())
    rise = rng.uniform(*ranges.rise)
    rises = {up: rise, down: -rise} if up != down else {}
    # Every straight gets the least length that it needs; the rest of the length is shared out at random.
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
    side = rng.choice((-1.0, 1.0))  # +1 leads from the robot's right to its left, -1 back
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
