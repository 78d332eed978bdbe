"""Box pushing: a paddle moves a box over the table to a goal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torchrl.data import Composite

from ppt_rl.envs.arm import ArmEnv, Rows
from ppt_rl.envs.push.episode import BOXES, PushEpisodes, PushRandomisation, draw_episodes
from ppt_rl.envs.push.scene import PUSH_BOX, push_scene
from ppt_rl.envs.readings import sensor_span
from ppt_rl.envs.specs import SpecMaker

__all__ = ["PushEnv", "PushRewards"]

#: Names of the four reward groups (paper, section "Problem Statement").
REWARD_GROUPS = ("progress", "free_space", "contact", "power")
#: A box counts as flat when its vertical axis is within 10 degrees and its centre within 5 mm of lying [-], [m].
_FLAT_COSINE, _FLAT_HEIGHT = 0.985, 0.005
#: Yaw of the paddle behind the box, as a share of the push's: the box stands square to the table, give or take, so in a
#: steep push a paddle square to the push would meet a corner [-].
_APPROACH_YAW = 0.7


@dataclass(frozen=True)
class PushRewards:
    """Weights of the four reward groups; each group is its own entry under ``reward_terms``.

    Attributes:
        progress: of the box's way to the goal, whole way = 1 [1].
        precision: at the end, times ``exp(-distance / 2 cm)`` [1].
        success: at the end, if the task is done [1].
        free_space: before first touch, of the tool's way to the box, whole way = 1 [1].
        contact: penalty on contact force above ``force_limit`` [1/(N s)].
        force_limit: [N].
        power: penalty on measured work, in or out [1/J].
    """

    progress: float = 1.0
    precision: float = 1.0
    success: float = 1.0
    free_space: float = 0.2
    contact: float = 0.2
    force_limit: float = 5.0
    power: float = 0.1


class PushEnv(ArmEnv):
    """Push a box to a goal within the horizon and leave it there, flat.

    Success is judged at the end: the box's centre within ``success_radius`` of the goal, and flat. Adds to the
    observations of :class:`ArmEnv`:

    * ``box_pose`` 7 [m, -]: privileged, for critics; a policy for deployment leaves it out;
    * ``box_start`` 2 and ``goal`` 2 [m], ``box_size`` 1 [m]: what is known at test time, fixed over an episode;
    * ``via_phase`` 3, ``via_position`` (3, 3), ``via_cov`` (3, 3, 3), ``via_mask`` 3: via-points in (x, y, yaw) for the
      reference: start of the tool, behind the box, goal minus the offset between tool and box centre;
    * ``progress`` 1 in [0, 1] and ``success`` 1 (bool), and the reward groups under ``reward_terms``.

    MuJoCo has one friction coefficient per contact: it takes the kinetic one, static friction is not modelled.

    Args:
        num_envs: number of environments.
        box_sizes: edges of the boxes to draw from [m]: 0.06, 0.08, or both.
        randomisation: ranges of what is drawn.
        rewards: weights of the reward groups.
        success_radius: [m].
        **kwargs: as for :class:`ArmEnv`.

    Raises:
        ValueError: if a box size is unknown or a number is out of range.

    Source:
        Paper, section "Box Pushing".

    Examples:
        >>> env = PushEnv(num_envs=2, box_sizes=(0.06,), seed=0)
        >>> env.reset()["goal"].shape
        torch.Size([2, 2])
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        box_sizes: Sequence[float] = (0.06, 0.08),
        randomisation: PushRandomisation | None = None,
        rewards: PushRewards | None = None,
        success_radius: float = 0.02,
        **kwargs: Any,
    ) -> None:
        unknown = [size for size in box_sizes if size not in BOXES]
        if unknown or not box_sizes:
            raise ValueError(f"box_sizes are {tuple(box_sizes)}; expected edges out of {tuple(BOXES)} m.")
        if not success_radius > 0:
            raise ValueError(f"success_radius is {success_radius}; expected a length above 0 m.")
        self.box_sizes = tuple(box_sizes)
        self.randomisation = PushRandomisation() if randomisation is None else randomisation
        self.rewards = PushRewards() if rewards is None else rewards
        self.success_radius = float(success_radius)
        super().__init__(num_envs, **kwargs)

    horizon_terminates = True

    # -- episode ------------------------------------------------------------------------------------------------------

    def _scene(self) -> Any:
        return push_scene(self.arm, self.tool, physics_dt=self.engine_config.physics_dt)

    def _prepare(self, model: Any) -> None:
        self._box_slice = sensor_span(model, "box_position", "box_orientation")
        self._episode = PushEpisodes(self.num_envs, self.dtype)
        weights, dt = self.rewards, self.control_dt
        # Per group: progress and free space are shares of a way, contact and power are rates.
        rates = [weights.progress, weights.free_space, -weights.contact * dt, -weights.power * dt]
        self._weights = torch.tensor(rates, dtype=self.dtype)

    def _begin(self, rows: Rows) -> np.ndarray:
        drawn = draw_episodes(self._rng, len(rows), self.randomisation, self.box_sizes)
        self._episode.write(rows, drawn)
        for row in rows:
            self._write_parameters(self.engine.models[row], int(row))
        pose = torch.tensor(self.start_pose, dtype=torch.float64).repeat(len(rows), 1)
        pose[:, :2] = torch.from_numpy(drawn["tool"])
        arm = self._arm_position(pose).numpy()
        half = 0.5 * drawn["yaw"]
        size = drawn["size"]
        box = [
            drawn["box"],
            0.5 * size[:, None],
            np.cos(half)[:, None],
            np.zeros((len(rows), 2)),
            np.sin(half)[:, None],
        ]
        return np.concatenate([arm, *box], -1)

    def _write_parameters(self, model: Any, row: int) -> None:
        half, mass, friction = (float(self._episode.physical[key][row]) for key in ("half", "mass", "friction"))
        geom, body = model.geom(PUSH_BOX), model.body(PUSH_BOX)
        geom.size[:] = half
        geom.friction[0] = friction
        body.mass[:] = mass
        body.inertia[:] = mass * (2 * half) ** 2 / 6
        model.body("goal").pos[:2] = self._episode.goal[row].numpy()

    def _task_reset(self, rows: Tensor) -> dict[str, Any]:
        episode, box = self._episode, self._sensors[:, self._box_slice]
        tool = self._sensors[:, self._readings.slices["pose"]]
        ways = self._ways(box, tool)
        episode.ways[rows], episode.first_ways[rows] = ways[rows], ways[rows].clamp_min(1e-3)
        episode.touched[rows] = False
        episode.via_position[rows] = self._via_points(tool)[rows]
        terms = torch.zeros(self.num_envs, len(REWARD_GROUPS), dtype=self.dtype)
        return self._task_observation(box, terms, ways, self._success(box, ways, self._elapsed >= self.horizon))

    def _success(self, box: Tensor, ways: Tensor, ended: Tensor) -> Tensor:
        if not bool(ended.any()):
            return torch.zeros_like(ended)
        return ended & (ways[:, :1] < self.success_radius) & self._is_flat(box)

    def _task_step(self, observation: dict[str, Any], ended: Tensor) -> dict[str, Any]:
        episode, box = self._episode, self._sensors[:, self._box_slice]
        ways = self._ways(box, observation["pose"])
        success = self._success(box, ways, ended)
        terms = self._reward_terms(observation, ways, success, ended)
        episode.ways = ways
        episode.touched = episode.touched | (ways[:, :1] < episode.first_ways[:, :1] - 1e-3)
        task = self._task_observation(box, terms, ways, success)
        task["reward"] = terms.sum(-1, keepdim=True)
        return task

    # -- reward -------------------------------------------------------------------------------------------------------

    def _reward_terms(self, observation: dict[str, Any], ways: Tensor, success: Tensor, ended: Tensor) -> Tensor:
        """``(num_envs, 4)`` rewards of the groups, in the order of :data:`REWARD_GROUPS`."""
        episode, weights = self._episode, self.rewards
        wrench = observation["wrench"]
        gained = (episode.ways - ways) / episode.first_ways
        excess = (torch.linalg.vector_norm(wrench[:, :3], dim=-1, keepdim=True) - weights.force_limit).clamp_min(0.0)
        power = (wrench * observation["twist"]).sum(-1, keepdim=True).abs()  # [W]
        terms = torch.cat([gained, excess, power], -1) * self._weights
        terms[:, 1:2] *= ~episode.touched
        if bool(ended.any()):
            precision = weights.precision * torch.exp(-ways[:, :1] / self.success_radius)
            terms[:, :1] += (precision + weights.success * success) * ended
        return terms

    def _ways(self, box: Tensor, tool: Tensor) -> Tensor:
        """``(num_envs, 2)`` distances in the plane, box to goal and tool to box [m]."""
        plane = torch.stack([self._episode.goal, tool[:, :2]], 1) - box[:, None, :2]
        return torch.linalg.vector_norm(plane, dim=-1)

    def _is_flat(self, box: Tensor) -> Tensor:
        x, y = box[:, 4:5], box[:, 5:6]
        upright = 1 - 2 * (x * x + y * y) > _FLAT_COSINE  # z axis of the box against the world's
        return upright & ((box[:, 2:3] - self._episode.half).abs() < _FLAT_HEIGHT)

    # -- observations -------------------------------------------------------------------------------------------------

    def _via_points(self, tool: Tensor) -> Tensor:
        """``(num_envs, 3, 3)`` via-points (x, y, yaw): where the tool starts, behind the box, and at the goal."""
        episode = self._episode
        way = episode.goal - episode.box_start
        direction = way / way.norm(dim=-1, keepdim=True)
        yaw = torch.atan2(direction[:, 1:], direction[:, :1])
        offset = episode.half + self.tool.half_thickness  # box centre to bar centre in touch [m]
        start = torch.cat([tool[:, :2], torch.zeros_like(yaw)], -1)
        behind = torch.cat([episode.box_start - (offset + 0.02) * direction, _APPROACH_YAW * yaw], -1)
        end = torch.cat([episode.goal - offset * direction, yaw], -1)
        return torch.stack([start, behind, end], 1)

    def _task_observation(self, box: Tensor, terms: Tensor, ways: Tensor, success: Tensor) -> dict[str, Any]:
        episode = self._episode
        return {
            "box_pose": box,
            "box_start": episode.box_start,
            "box_size": 2 * episode.half,
            "goal": episode.goal,
            "via_phase": episode.via_phase,
            "via_position": episode.via_position,
            "via_cov": episode.via_cov,
            "via_mask": episode.via_mask,
            "progress": (1 - ways[:, :1] / episode.first_ways[:, :1]).clamp(0.0, 1.0),
            "success": success,
            "reward_terms": dict(zip(REWARD_GROUPS, terms.split(1, -1), strict=True)),
        }

    def _task_spec(self, make: SpecMaker) -> Composite:
        real, flag = make.real, make.flag
        return make.nest(
            box_pose=real(7), box_start=real(2), box_size=real(1), goal=real(2), via_phase=real(3),
            via_position=real(3, 3), via_cov=real(3, 3, 3), via_mask=flag(3), progress=real(1), success=flag(),
            reward_terms=make.nest(**{name: real(1) for name in REWARD_GROUPS}),
        )  # fmt: skip
