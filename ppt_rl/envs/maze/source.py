"""Where the mazes of an environment come from: classes, so that an environment can be copied and pickled."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ppt_rl.arms import Arm
from ppt_rl.envs.maze.feasibility import check_corridor
from ppt_rl.envs.maze.geometry import build_corridor
from ppt_rl.envs.maze.layout import MazeLayout
from ppt_rl.envs.maze.sampling import MazeRanges, StraightRanges, random_maze, random_straight
from ppt_rl.envs.maze.scene import check_pieces
from ppt_rl.envs.maze.start import check_start
from ppt_rl.functional.argument_checks import require_instance

__all__ = ["GivenMazes", "RandomMazes", "RandomStraights", "Source"]

#: Draws the maze of an episode, given a random generator. An environment with a lambda cannot be pickled.
Source = Callable[[np.random.Generator], MazeLayout]


@dataclass(frozen=True)
class RandomStraights:
    """Straight corridors of :func:`~ppt_rl.envs.maze.sampling.random_straight`.

    Attributes:
        ranges: ranges of the corridors; None takes the defaults.
        arm: the arm, which must reach the corridors.
    """

    ranges: StraightRanges | None
    arm: Arm

    def __post_init__(self) -> None:
        """Check the types."""
        if self.ranges is not None:
            require_instance("ranges", self.ranges, StraightRanges)
        require_instance("arm", self.arm, Arm)

    def __call__(self, rng: np.random.Generator) -> MazeLayout:
        """Draw a corridor."""
        return random_straight(rng, self.ranges, self.arm)


@dataclass(frozen=True)
class RandomMazes:
    """Mazes of :func:`~ppt_rl.envs.maze.sampling.random_maze`.

    Attributes:
        ranges: ranges of the mazes; None takes the defaults.
        arm: the arm, which must reach the mazes.
    """

    ranges: MazeRanges | None
    arm: Arm

    def __post_init__(self) -> None:
        """Check the types."""
        if self.ranges is not None:
            require_instance("ranges", self.ranges, MazeRanges)
        require_instance("arm", self.arm, Arm)

    def __call__(self, rng: np.random.Generator) -> MazeLayout:
        """Draw a maze."""
        return random_maze(rng, self.ranges, self.arm)


class GivenMazes:
    """Given mazes in turn; after the last one the first one follows again.

    Args:
        layouts: the mazes.
        arm: the arm, which must reach them.

    Raises:
        ValueError: if there is no layout, or one is of another type or cannot be driven through.
    """

    def __init__(self, layouts: Sequence[MazeLayout], arm: Arm) -> None:
        require_instance("layouts", layouts, Sequence)
        require_instance("arm", arm, Arm)
        if not layouts:
            raise ValueError("layouts is empty; expected at least one MazeLayout.")
        for index, layout in enumerate(layouts):
            require_instance(f"layouts[{index}]", layout, MazeLayout)
            corridor = build_corridor(layout)
            check_corridor(corridor, layout, arm.reach)
            check_pieces(corridor)
            check_start(layout)
        self.layouts, self.given = tuple(layouts), 0

    def __call__(self, _: np.random.Generator) -> MazeLayout:
        """The next maze."""
        layout = self.layouts[self.given % len(self.layouts)]
        self.given += 1
        return layout
