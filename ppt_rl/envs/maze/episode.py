"""What a maze episode is drawn from, and where a tool is in its maze."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ppt_rl.envs.arm import Rows
from ppt_rl.envs.maze.geometry import Corridor

__all__ = ["MazeEpisodes", "MazePlace", "MazeRandomisation"]

#: Corners of a centre line that an environment has room for.
_CORNERS = 40


@dataclass(frozen=True)
class MazeRandomisation:
    """Ranges of how an episode starts, drawn from uniformly; the maze is drawn by its own ranges.

    Attributes:
        along: of the tool from the closed end [m].
        across: of the tool from the centre line, as a share of the room on either side [-].
        heading_error: of the heading that the robot is told, against the corridor's [rad].
    """

    along: tuple[float, float] = (0.03, 0.04)
    across: tuple[float, float] = (-0.7, 0.7)
    heading_error: tuple[float, float] = (-0.2, 0.2)

    def __post_init__(self) -> None:
        """Refuse empty ranges."""
        for name, (low, high) in vars(self).items():
            if not low <= high:
                raise ValueError(f"randomisation range {name} is ({low}, {high}); expected low <= high.")
        if self.along[0] < 0.02 or max(map(abs, self.across)) > 0.95:
            raise ValueError(f"{self} puts the tool into a wall; expected along >= 0.02 m and across within +-0.95.")


class MazePlace(NamedTuple):
    """Where tools are along their mazes, ``(B, 1)`` each.

    Attributes:
        travelled: along the centre line, of the nearest point on it [m].
        offset: to the left of the centre line [m].
        floor: height of the floor there [m].
        half_width: from centre line to wall there, at most [m].
        heading: of the centre line there [rad].
    """

    travelled: Tensor
    offset: Tensor
    floor: Tensor
    half_width: Tensor
    heading: Tensor


class MazeEpisodes:
    """The mazes of a batch of environments, and what their reward remembers.

    Args:
        num_envs: number of environments.
        dtype: precision of the tensors.
    """

    def __init__(self, num_envs: int, dtype: torch.dtype) -> None:
        def zeros(*shape: int) -> Tensor:
            return torch.zeros(num_envs, *shape, dtype=dtype)

        self.dtype = dtype
        self.centre = zeros(_CORNERS, 3)
        self.half_width = zeros(_CORNERS - 1)
        self.at = zeros(_CORNERS)  # of each corner, along the centre line [m]
        self.length = zeros(1) + 1
        self.start_heading = zeros(1)
        self.travelled, self.velocity = zeros(1), zeros(3)
        self.over = torch.zeros(num_envs, 1, dtype=torch.bool)
        self.friction = np.zeros(num_envs)
        self.corridors: list[Corridor | None] = [None] * num_envs

    def write(self, row: int, corridor: Corridor, friction: float) -> None:
        """Take over a maze; the rest of the room repeats its end.

        Args:
            row: environment.
            corridor: its maze.
            friction: of walls and floor on the tool [-].

        Raises:
            ValueError: if the centre line has too many corners.
        """
        count = len(corridor.centre)
        if count > _CORNERS:
            raise ValueError(f"the maze's centre line has {count} corners; expected at most {_CORNERS}. Shorten it.")
        self.corridors[row], self.friction[row] = corridor, friction
        centre = torch.from_numpy(corridor.centre).to(self.dtype)
        self.centre[row] = centre[-1]
        self.centre[row, :count] = centre
        self.half_width[row] = float(corridor.half_width[-1])
        self.half_width[row, : count - 1] = torch.from_numpy(corridor.half_width).to(self.dtype)
        steps = torch.linalg.vector_norm(self.centre[row, 1:, :2] - self.centre[row, :-1, :2], dim=-1)
        self.at[row, 1:] = steps.cumsum(0)
        self.length[row] = self.at[row, -1]

    def begin(self, rows: Rows, heading: np.ndarray) -> None:
        """Open an episode. Observed tensors are replaced, not changed: earlier observations keep theirs.

        Args:
            rows: environments.
            heading: ``(R,)`` that the robot is told [rad].
        """
        index = torch.from_numpy(rows)
        self.start_heading, self.over = self.start_heading.clone(), self.over.clone()
        self.start_heading[index, 0] = torch.from_numpy(heading).to(self.dtype)
        self.over[index] = False

    def locate(self, position: Tensor) -> MazePlace:
        """Where tools are.

        Args:
            position: ``(B, 3)`` [m].

        Returns:
            The nearest places on the centre lines.
        """
        begin, way = self.centre[:, :-1], self.centre.diff(dim=1)  # (B, P - 1, 3)
        plane = way[..., :2]
        square = plane.square().sum(-1)
        to_tool = position[:, None, :2] - begin[..., :2]
        share = ((to_tool * plane).sum(-1) / square.clamp_min(1e-12)).clamp(0.0, 1.0)
        away = torch.linalg.vector_norm(to_tool - share.unsqueeze(-1) * plane, dim=-1)
        # Pieces without a length only fill the room.
        nearest = away.masked_fill(square < 1e-10, torch.inf).argmin(-1, keepdim=True)  # (B, 1)

        def there(values: Tensor) -> Tensor:
            return values.gather(1, nearest)

        size = there(square).sqrt()
        x, y = there(plane[..., 0]), there(plane[..., 1])
        side = torch.sign(x * there(to_tool[..., 1]) - y * there(to_tool[..., 0]))
        return MazePlace(
            travelled=there(self.at[:, :-1]) + there(share) * size,
            offset=side * there(away),
            floor=there(begin[..., 2]) + there(share) * there(way[..., 2]),
            half_width=there(self.half_width),
            heading=torch.atan2(y, x),
        )
