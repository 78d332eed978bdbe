"""The state of maze episodes: which maze each environment has, and where its tool is in it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ppt_rl.envs.episodes import Episodes
from ppt_rl.envs.maze.geometry import WALL_HEIGHT, Corridor
from ppt_rl.envs.maze.scene import PIECE_NAMES, boxes_of

__all__ = ["MazeEnd", "MazeEpisodes", "MazePosition"]

#: Largest number of corners of a centre line.
_CORNERS = 40
#: Height of the tool's end above the floor at which it is out of the corridor [m].
_LIFTED = 0.8 * WALL_HEIGHT
#: Distance from the end of the centre line at which it counts as reached [m].
_AT_END = 1e-4


class MazePosition(NamedTuple):
    """Where tools are in their corridors, at the nearest point of the centre line; ``(B, 1)`` each.

    Attributes:
        travelled: distance of that point along the centre line [m].
        offset: distance of the tool to the left of the centre line [m].
        floor: height of the floor at that point [m].
        half_width: largest distance from the centre line to a wall there [m].
        heading: direction of the centre line there [rad].
    """

    travelled: Tensor
    offset: Tensor
    floor: Tensor
    half_width: Tensor
    heading: Tensor


class MazeEnd(NamedTuple):
    """Which events end an episode; ``(B, 1)`` booleans.

    Attributes:
        success: the end of the centre line is reached, and nothing failed.
        left_corridor: the tool's axis is beyond a wall, or its end is lifted over the walls.
        unsafe: the force is above the safe limit.
    """

    success: Tensor
    left_corridor: Tensor
    unsafe: Tensor

    @property
    def failed(self) -> Tensor:
        """``(B, 1)`` True where the episode ends unsafely."""
        return self.left_corridor | self.unsafe


class MazeEpisodes(Episodes):
    """The mazes of a batch of environments, and what the rewards compare the next control step with.

    Args:
        num_envs: number of environments.
        dtype: precision of the tensors.
        device: where they are.
    """

    def _allocate(self) -> None:
        num_envs, zeros = self.num_envs, self.zeros
        self.centre = zeros(_CORNERS, 3)
        self.half_width = zeros(_CORNERS - 1)
        self.at = zeros(_CORNERS)  # distance of each corner along the centre line [m]
        self.length = zeros(1) + 1
        self.start_heading = zeros(1)
        self.travelled, self.velocity = zeros(1), zeros(3)  # at the last control step
        self.over = torch.zeros(num_envs, 1, dtype=torch.bool, device=self.device)
        self.friction = zeros(1).double()
        self.pieces = zeros(len(PIECE_NAMES), 10).double()  # of the walls and floors, see boxes_of
        self.corridors: list[Corridor | None] = [None] * num_envs

    def write(self, row: int, corridor: Corridor, friction: float) -> None:
        """Store the maze of one environment. Unused corners repeat the last one.

        Args:
            row: index of the environment.
            corridor: geometry of its maze.
            friction: friction coefficient between the tool and walls or floor [-].

        Raises:
            ValueError: if the centre line has too many corners, or the maze too many pieces.
        """
        count = len(corridor.centre)
        if count > _CORNERS:
            raise ValueError(f"the maze's centre line has {count} corners; expected at most {_CORNERS}. Shorten it.")
        self.corridors[row], self.friction[row] = corridor, friction
        self.pieces[row] = torch.from_numpy(boxes_of(corridor))
        centre = torch.from_numpy(corridor.centre).to(self.dtype)
        self.centre[row] = centre[-1]
        self.centre[row, :count] = centre
        self.half_width[row] = float(corridor.half_width[-1])
        self.half_width[row, : count - 1] = torch.from_numpy(corridor.half_width).to(self.dtype)
        steps = torch.linalg.vector_norm(self.centre[row, 1:, :2] - self.centre[row, :-1, :2], dim=-1)
        self.at[row, 1:] = steps.cumsum(0)
        self.length[row] = self.at[row, -1]

    def begin(self, rows: Tensor, heading: np.ndarray) -> None:
        """Begin episodes.

        Args:
            rows: indices of the environments.
            heading: ``(R,)`` heading that each robot is told [rad].
        """
        self.replace(rows, start_heading=heading[:, None], over=False)

    def measure_from(self, rows: Tensor, position: MazePosition) -> None:
        """Measure the progress of some environments from where their tools are now, at rest.

        Args:
            rows: indices of the environments.
            position: of the tools of all environments.
        """
        self.replace(rows, travelled=position.travelled[rows], velocity=0.0)

    def locate(self, position: Tensor) -> MazePosition:
        """Find where tools are in their corridors.

        Args:
            position: ``(B, 3)`` or longer, starting with the position of the tool's end [m].

        Returns:
            The nearest points on the centre lines.
        """
        begin, edge = self.centre[:, :-1], self.centre.diff(dim=1)  # (B, P - 1, 3)
        plane = edge[..., :2]
        square = plane.square().sum(-1)
        to_tool = position[:, None, :2] - begin[..., :2]
        share = ((to_tool * plane).sum(-1) / square.clamp_min(1e-12)).clamp(0.0, 1.0)
        away = torch.linalg.vector_norm(to_tool - share.unsqueeze(-1) * plane, dim=-1)
        # Pieces without length belong to unused corners.
        nearest = away.masked_fill(square < 1e-10, torch.inf).argmin(-1, keepdim=True)  # (B, 1)

        def there(values: Tensor) -> Tensor:
            return values.gather(1, nearest)

        size = there(square).sqrt()
        x, y = there(plane[..., 0]), there(plane[..., 1])
        side = torch.sign(x * there(to_tool[..., 1]) - y * there(to_tool[..., 0]))
        return MazePosition(
            travelled=there(self.at[:, :-1]) + there(share) * size,
            offset=side * there(away),
            floor=there(begin[..., 2]) + there(share) * there(edge[..., 2]),
            half_width=there(self.half_width),
            heading=torch.atan2(y, x),
        )

    def judge(self, position: MazePosition, height: Tensor, force: Tensor, max_force: float) -> MazeEnd:
        """Decide which episodes end.

        Args:
            position: of the tools.
            height: ``(B, 1)`` height of the tool's end [m].
            force: ``(B, 3)`` at the wrist [N].
            max_force: largest safe force [N].

        Returns:
            What ends them.
        """
        lifted = height - position.floor > _LIFTED
        left = (position.offset.abs() > position.half_width) | lifted
        unsafe = force.square().sum(-1, keepdim=True) > max_force**2
        success = position.travelled >= self.length - _AT_END
        return MazeEnd(success & ~(left | unsafe), left, unsafe)

    def advance(self, position: MazePosition, velocity: Tensor, end: MazeEnd) -> None:
        """Remember a control step, for the rewards of the next one.

        Args:
            position: of the tools after the step.
            velocity: ``(B, 3)`` of the tools [m/s].
            end: which episodes are over.
        """
        self.travelled, self.velocity = position.travelled, velocity
        self.over = end.success | end.failed
