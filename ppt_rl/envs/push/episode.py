"""What a pushing episode is drawn from, and what an environment remembers of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ppt_rl.envs.arm import Rows

__all__ = ["BOXES", "PushDistances", "PushEpisodes", "PushRandomisation", "draw_episodes"]

#: Nominal boxes: edge [m] to mass [kg] (paper, section "Box Pushing").
BOXES = {0.06: 0.050, 0.08: 0.080}


@dataclass(frozen=True)
class PushRandomisation:
    """Ranges of what is drawn for each episode, uniformly.

    Attributes:
        friction: sliding friction of the box on table and paddle, the kinetic one [-].
        mass: factor on the nominal mass [-].
        box_x: start of the box [m].
        box_y: start of the box [m].
        box_yaw: yaw of the box off the table's axes [rad].
        goal_x: goal of the box's centre [m].
        goal_y: goal of the box's centre [m].
        tool_x: start of the tool [m].
        tool_y: start of the tool [m].
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

    def __post_init__(self) -> None:
        """Refuse empty ranges."""
        for name, (low, high) in vars(self).items():
            if not low <= high:
                raise ValueError(f"randomisation range {name} is ({low}, {high}); expected low <= high.")


#: Phases of the via-points, and how exactly they are meant, in x, y [m] and yaw [rad].
_VIA_PHASE = (0.0, 0.35, 1.0)
_VIA_STD = ((1e-3, 1e-3, 1e-2), (5e-3, 5e-3, 3e-2), (1e-3, 1e-3, 1e-2))


class PushDistances(NamedTuple):
    """Distances on the map, between centres.

    Attributes:
        box_to_goal: ``(B, 1)`` [m].
        tool_to_box: ``(B, 1)`` [m].
    """

    box_to_goal: Tensor
    tool_to_box: Tensor


@dataclass
class PushEpisodes:
    """What was drawn for each environment, and what the reward remembers.

    Attributes:
        num_envs: number of environments.
        dtype: precision of the tensors.
        physical: half edge [m], mass [kg] and friction [-] of each box.
    """

    num_envs: int
    dtype: torch.dtype
    physical: dict[str, np.ndarray] = field(init=False)

    def __post_init__(self) -> None:
        def zeros(*shape: int) -> Tensor:
            return torch.zeros(self.num_envs, *shape, dtype=self.dtype)

        self.physical = {name: np.zeros(self.num_envs) for name in ("half", "mass", "friction")}
        self.half, self.box_start, self.goal = zeros(1), zeros(2), zeros(2)
        self.previous, self.initial = PushDistances(zeros(1), zeros(1)), PushDistances(zeros(1) + 1, zeros(1) + 1)
        self.touched = torch.zeros(self.num_envs, 1, dtype=torch.bool)
        self.via_phase = torch.tensor(_VIA_PHASE, dtype=self.dtype).repeat(self.num_envs, 1)
        self.via_position = zeros(3, 3)
        self.via_cov = torch.tensor(_VIA_STD, dtype=self.dtype).square().diag_embed().repeat(self.num_envs, 1, 1, 1)
        self.via_mask = torch.ones(self.num_envs, 3, dtype=torch.bool)

    def write(self, rows: Rows, drawn: dict[str, np.ndarray]) -> None:
        """Take over a draw. Observed tensors are replaced, not changed: earlier observations keep theirs."""
        index = torch.from_numpy(rows)
        self.physical["half"][rows] = 0.5 * drawn["size"]
        self.physical["mass"][rows] = drawn["mass"]
        self.physical["friction"][rows] = drawn["friction"]
        for name, value in (
            ("half", 0.5 * drawn["size"][:, None]),
            ("box_start", drawn["box"]),
            ("goal", drawn["goal"]),
        ):
            tensor = getattr(self, name).clone()
            tensor[index] = torch.from_numpy(value).to(self.dtype)
            setattr(self, name, tensor)
        self.via_position = self.via_position.clone()

    def begin(self, rows: Tensor, distances: PushDistances) -> None:
        """Measure progress from here on.

        Args:
            rows: environments whose episode begins.
            distances: of all environments.
        """
        for previous, initial, now in zip(self.previous, self.initial, distances, strict=True):
            previous[rows], initial[rows] = now[rows], now[rows].clamp_min(1e-3)
        self.touched[rows] = False

    def advance(self, distances: PushDistances) -> None:
        """Take over the distances after a control step. A box that is 1 mm nearer to its goal has been touched."""
        self.previous = distances
        self.touched = self.touched | (distances.box_to_goal < self.initial.box_to_goal - 1e-3)


def draw_episodes(
    rng: np.random.Generator, count: int, ranges: PushRandomisation, box_sizes: Sequence[float]
) -> dict[str, np.ndarray]:
    """Draw episodes.

    Args:
        rng: source of randomness.
        count: how many.
        ranges: what to draw from.
        box_sizes: edges of the boxes [m].

    Returns:
        Arrays over the episodes by name: ``size`` [m], ``mass`` [kg], ``box``, ``goal``, ``tool`` (x, y) [m], ``yaw``
        [rad], ``friction`` [-].
    """

    def uniform(low_high: tuple[float, float]) -> np.ndarray:
        return rng.uniform(*low_high, size=count)

    size = rng.choice(np.asarray(box_sizes), size=count)
    mass = np.asarray([BOXES[float(edge)] for edge in size]) * uniform(ranges.mass)
    box = np.stack([uniform(ranges.box_x), uniform(ranges.box_y)], -1)
    goal = np.stack([uniform(ranges.goal_x), uniform(ranges.goal_y)], -1)
    tool = np.stack([uniform(ranges.tool_x), uniform(ranges.tool_y)], -1)
    yaw = uniform(ranges.box_yaw)
    friction = uniform(ranges.friction)
    return {"size": size, "mass": mass, "box": box, "goal": goal, "tool": tool, "yaw": yaw, "friction": friction}
