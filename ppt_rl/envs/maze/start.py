"""How a maze episode starts: where the tool stands, and which heading the robot is told."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ppt_rl.envs.limits import Bound, require_bounded_ranges
from ppt_rl.envs.maze.geometry import Array, Corridor
from ppt_rl.envs.maze.layout import MazeLayout, Straight

__all__ = ["MazeRandomisation", "check_start", "draw_start"]

#: Least length of a first straight: the tool must fit in it before the first corner [m].
_ROOM = 0.055
#: Distance from the tool's end to the floor [m].
_CLEARANCE = 5e-4
_BOUNDS: dict[str, Bound] = {"along": (-2.0, 2.0, "m"), "across": (-2.0, 2.0, ""), "heading_error": (-7.0, 7.0, "rad")}


@dataclass(frozen=True)
class MazeRandomisation:
    """Ranges of how an episode starts; each quantity is drawn uniformly. The maze itself has ranges of its own.

    Attributes:
        along: distance of the tool from the closed end [m].
        across: offset of the tool to the left of the centre line, as a share of the free space on that side [-].
        heading_error: error of the heading that the robot is told [rad].
    """

    along: tuple[float, float] = (0.03, 0.04)
    across: tuple[float, float] = (-0.7, 0.7)
    heading_error: tuple[float, float] = (-0.2, 0.2)

    def __post_init__(self) -> None:
        """Check that no range is empty and that the tool starts inside the corridor."""
        require_bounded_ranges(self, _BOUNDS)
        if self.along[0] < 0.02 or max(map(abs, self.across)) > 0.95:
            raise ValueError(f"{self} puts the tool into a wall; expected along >= 0.02 m and across within +-0.95.")


def check_start(layout: MazeLayout) -> None:
    """Raise if the first segment of a maze is too short for the tool to start in.

    Args:
        layout: the maze.

    Raises:
        ValueError: if it is.
    """
    first = layout.segments[0]
    if isinstance(first, Straight) and first.length < _ROOM:
        raise ValueError(f"the first segment is {first}; expected a length of at least {_ROOM} m, to start in.")


def draw_start(
    rng: np.random.Generator, ranges: MazeRandomisation, layout: MazeLayout, corridor: Corridor, radius: float
) -> Array:
    """Draw where the tool starts, just above the floor.

    Args:
        rng: source of randomness.
        ranges: ranges to draw from.
        layout: the maze.
        corridor: its geometry.
        radius: radius of the tool [m].

    Returns:
        ``(3,)`` position of the tool's end [m].
    """
    free = 0.5 * layout.width - radius
    along, across = rng.uniform(*ranges.along), free * rng.uniform(*ranges.across)
    direction = np.asarray([np.cos(layout.heading), np.sin(layout.heading)])
    left = np.asarray([-direction[1], direction[0]])
    position = corridor.centre[0, :2] + along * direction + across * left
    # A ramp of the first straight may begin under the tool, which then stands on the highest floor below it.
    corners = np.linalg.norm(corridor.centre[:4, :2] - corridor.centre[0, :2], axis=1)  # of the first straight [m]
    under = along + radius * np.linspace(-1.0, 1.0, 9)
    floor = np.interp(under, corners, corridor.centre[:4, 2]).max()
    return np.concatenate([position, [floor + _CLEARANCE]])
