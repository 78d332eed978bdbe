"""Pushing episodes: what is drawn at random, and the state that an environment keeps."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from ppt_rl.envs.episodes import Episodes
from ppt_rl.envs.limits import Bound, require_bounded_ranges
from ppt_rl.envs.push.box import Boxes
from ppt_rl.envs.row_generators import RowGenerators
from ppt_rl.functional.constants import constant

__all__ = ["PushDistances", "PushEpisodes", "PushRandomisation", "check_start", "draw_episodes"]

_PLACE: Bound = (-2.0, 2.0, "m")
_BOUNDS: dict[str, Bound] = {
    "friction": (0.0, 5.0, ""), "mass": (0.1, 10.0, ""), "box_yaw": (-3.15, 3.15, "rad"),
    "box_x": _PLACE, "box_y": _PLACE, "goal_x": _PLACE, "goal_y": _PLACE, "tool_x": _PLACE, "tool_y": _PLACE,
    "goal_yaw": (-3.15, 3.15, "rad"), "com": (-0.1, 0.1, "m"), "error": (-0.1, 0.1, "m"),
}  # fmt: skip

#: Phases of the via-points [-], and their standard deviations in x, y [m] and yaw [rad].
_VIA_PHASE = (0.0, 0.35, 1.0)
_VIA_STD = ((1e-3, 1e-3, 1e-2), (5e-3, 5e-3, 3e-2), (1e-3, 1e-3, 1e-2))
#: Ranges that two coordinates share, each of which is drawn.
_PAIRS = ("com", "error")


@dataclass(frozen=True)
class PushRandomisation:
    """Ranges of what is drawn for each episode; each quantity is drawn uniformly.

    Attributes:
        friction: kinetic friction coefficient between the box and table or paddle [-].
        mass: factor on the nominal mass [-].
        box_x: x of the box at the start [m].
        box_y: y of the box at the start [m].
        box_yaw: yaw of the box relative to the table at the start [rad].
        goal_x: x of the goal of the box's centre [m].
        goal_y: y of the goal of the box's centre [m].
        tool_x: x of the tool at the start [m].
        tool_y: y of the tool at the start [m].
        goal_yaw: yaw of the goal, where the task asks for one [rad].
        com: offset of the box's centre of mass from its centre, along the box's x and along its y [m].
        error: error of the known position of the box at the start, in x and in y [m].
    """

    friction: tuple[float, float] = (0.20, 0.60)
    mass: tuple[float, float] = (0.85, 1.15)
    box_x: tuple[float, float] = (0.43, 0.48)
    box_y: tuple[float, float] = (-0.10, 0.10)
    box_yaw: tuple[float, float] = (-0.2, 0.2)
    goal_x: tuple[float, float] = (0.60, 0.70)
    goal_y: tuple[float, float] = (-0.15, 0.15)
    tool_x: tuple[float, float] = (0.355, 0.365)
    tool_y: tuple[float, float] = (-0.02, 0.02)
    goal_yaw: tuple[float, float] = (-0.6, 0.6)
    com: tuple[float, float] = (0.0, 0.0)
    error: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        """Check that no range is empty or absurd."""
        require_bounded_ranges(self, _BOUNDS)


class PushDistances(NamedTuple):
    """What is left to do, on the map.

    Attributes:
        box_to_goal: ``(B, 1)`` from the box's centre to the goal [m].
        tool_to_box: ``(B, 1)`` from the end-effector point to the box's centre [m].
        yaw_error: ``(B, 1)`` between the yaw of the box and that of its goal, in size [rad].
    """

    box_to_goal: Tensor
    tool_to_box: Tensor
    yaw_error: Tensor


class PushEpisodes(Episodes):
    """What was drawn for a batch of environments, and the distances that the rewards compare the next step with.

    Args:
        num_envs: number of environments.
        dtype: precision of the tensors.
        device: where they are.
    """

    def _allocate(self) -> None:
        num_envs, dtype, device, zeros = self.num_envs, self.dtype, self.device, self.zeros
        sizes = {"half": 1, "mass": 1, "friction": 1, "com": 2}  # [m], [kg], [-], in box axes [m]
        self.physical = {
            name: torch.zeros(num_envs, size, dtype=torch.float64, device=device) for name, size in sizes.items()
        }
        self.half, self.box_start, self.goal, self.goal_yaw = zeros(1), zeros(2), zeros(2), zeros(1)
        self.previous = PushDistances(zeros(1), zeros(1), zeros(1))
        self.initial = PushDistances(zeros(1) + 1, zeros(1) + 1, zeros(1))
        self.touched = torch.zeros(num_envs, 1, dtype=torch.bool, device=device)
        self.via_phase = torch.tensor(_VIA_PHASE, dtype=dtype, device=device).repeat(num_envs, 1)
        self.via_position = zeros(3, 3)
        self.via_cov = (
            torch.tensor(_VIA_STD, dtype=dtype, device=device).square().diag_embed().repeat(num_envs, 1, 1, 1)
        )
        self.via_mask = torch.ones(num_envs, 3, dtype=torch.bool, device=device)

    def write(self, rows: Tensor, drawn: dict[str, Tensor]) -> None:
        """Store what was drawn.

        Args:
            rows: indices of the environments.
            drawn: a draw of :func:`draw_episodes`.
        """
        half = 0.5 * drawn["size"]
        for name, value in (drawn | {"half": half}).items():
            if name in self.physical:
                self.physical[name][rows] = value
        self.replace(
            rows, half=half, box_start=drawn["box"] + drawn["error"], goal=drawn["goal"], goal_yaw=drawn["goal_yaw"]
        )

    def begin(self, rows: Tensor, distances: PushDistances) -> None:
        """Measure the progress of some environments from where tool and box are now.

        Args:
            rows: indices of the environments.
            distances: of all environments.
        """
        self.previous = PushDistances(
            *(_put(old, rows, now) for old, now in zip(self.previous, distances, strict=True))
        )
        for initial, now in zip(self.initial, distances, strict=True):
            initial[rows] = now[rows].clamp_min(1e-3)
        self.touched = self.touched.index_fill(0, rows, False)

    def advance(self, distances: PushDistances) -> None:
        """Remember the distances of a control step, for the rewards of the next one.

        Args:
            distances: of all environments. A box that has come 1 mm nearer to its goal counts as touched.
        """
        self.previous = distances
        start = self.initial.box_to_goal
        self.touched = self.touched | (distances.box_to_goal < start - constant(1e-3, start))


def _put(tensor: Tensor, rows: Tensor, source: Tensor) -> Tensor:
    """A copy with some rows of another tensor; observations may share the old one."""
    result = tensor.clone()
    result[rows] = source[rows]
    return result


def check_start(boxes: Boxes, ranges: PushRandomisation, tool: tuple[float, float, float], height: float) -> None:
    """Raise if a box may begin inside the tool, since MuJoCo would shoot it away.

    Args:
        boxes: the boxes to draw from.
        ranges: ranges to draw from.
        tool: half size of the tool's end along x, y and z [m].
        height: of the tool's centre at the start [m].

    Raises:
        ValueError: if it may.
    """
    turn = min(max(map(abs, ranges.box_yaw)), math.pi / 4)
    for size in boxes.sizes:
        reach = 0.5 * size * (math.cos(turn) + math.sin(turn))  # of a turned box along x and y [m]
        gaps = [height - tool[2] - size]
        for box, bar, half in ((ranges.box_x, ranges.tool_x, tool[0]), (ranges.box_y, ranges.tool_y, tool[1])):
            gaps += [box[0] - bar[1] - reach - half, bar[0] - box[1] - reach - half]
        if max(gaps) < 0:
            raise ValueError(
                f"a box of {size} m may begin inside the tool: randomisation.box_x begins at {ranges.box_x[0]} m; "
                f"expected at least {ranges.box_x[0] - gaps[1]:.3f} m. Raise it, or take a smaller box."
            )


def draw_episodes(
    generators: RowGenerators, rows: Tensor, ranges: PushRandomisation, boxes: Boxes
) -> dict[str, Tensor]:
    """Draw episodes at random.

    Args:
        generators: source of randomness of each environment.
        rows: ``(R,)`` indices of the environments.
        ranges: ranges to draw from.
        boxes: the boxes to draw from.

    Returns:
        Tensors in double precision: ``size`` [m], ``mass`` [kg], ``yaw`` and ``goal_yaw`` [rad] and ``friction`` [-],
        ``(R, 1)`` each; ``box``, ``goal``, ``tool``, ``com`` and ``error``, ``(R, 2)`` each (x, y) [m].
    """
    names = [name for name in vars(ranges) if name not in _PAIRS] + [name for name in _PAIRS for _ in range(2)]
    uniform = generators.uniform(rows, len(names) + 1)
    low, high = uniform.new_tensor([getattr(ranges, name) for name in names]).unbind(-1)
    values = low + (high - low) * uniform[:, 1:]
    drawn = dict(zip(names, values.split(1, -1), strict=True))
    which = (uniform[:, :1] * len(boxes.sizes)).long()
    return {
        "size": uniform.new_tensor(boxes.sizes)[which],
        "mass": uniform.new_tensor(boxes.masses)[which] * drawn["mass"],
        "box": torch.cat([drawn["box_x"], drawn["box_y"]], -1),
        "goal": torch.cat([drawn["goal_x"], drawn["goal_y"]], -1),
        "tool": torch.cat([drawn["tool_x"], drawn["tool_y"]], -1),
        "com": values[:, -4:-2],
        "error": values[:, -2:],
        "yaw": drawn["box_yaw"],
        "goal_yaw": drawn["goal_yaw"],
        "friction": drawn["friction"],
    }
