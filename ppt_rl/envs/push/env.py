"""Box pushing: a paddle pushes a box over the table to a goal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal, get_args

import torch
from torch import Tensor
from torchrl.data import Composite

from ppt_rl.envs.arm import ArmEnv
from ppt_rl.envs.limits import require_within
from ppt_rl.envs.physics import Parameter
from ppt_rl.envs.push import rewards as reward
from ppt_rl.envs.push.box import Boxes
from ppt_rl.envs.push.episode import PushDistances, PushEpisodes, PushRandomisation, check_start, draw_episodes
from ppt_rl.envs.push.reference import PushReference, push_via_points
from ppt_rl.envs.push.rewards import PushRewards
from ppt_rl.envs.push.scene import PUSH_BOX, push_scene, write_looks
from ppt_rl.envs.readings import sensor_span
from ppt_rl.envs.rewards import reward_spec, total_reward, work_penalty, zero_rewards
from ppt_rl.envs.specs import SpecMaker
from ppt_rl.functional.argument_checks import require_instance, require_number, shown
from ppt_rl.functional.checks import none_true
from ppt_rl.functional.constants import constant

__all__ = ["PushEnv", "PushGoal"]

#: What has to be at the goal: the centre of the box, or its yaw as well.
PushGoal = Literal["position", "pose"]

#: A box lies flat if the cosine of its tilt is above the first (10 degrees) and its height is off by less than the
#: second [-], [m].
_FLAT_COSINE, _FLAT_HEIGHT = 0.985, 0.005


class PushEnv(ArmEnv):
    """Push a box to a goal before the episode ends, and leave it lying flat.

    Success is judged at the end of the episode: the centre of the box must be within ``success_radius`` of the goal,
    and the box must lie flat. With ``goal="pose"`` its yaw must also be within ``success_yaw`` of that of the goal, so
    it has to be turned on the way. The observations are those of :class:`ArmEnv` and

    * ``box_pose`` 7 [m, -]: privileged, for critics; a policy for deployment does not read it;
    * ``box_start`` 2 [m], ``goal`` 2 [m] and ``box_size`` 1 [m]: known at test time, constant in an episode.
      ``box_start`` differs from the true start by the drawn error;
    * with ``goal="pose"``, ``goal_yaw`` 1 [rad], known as well, and ``yaw_error`` 1 [rad], privileged;
    * ``via_phase`` 3, ``via_position`` (3, 3), ``via_cov`` (3, 3, 3), ``via_mask`` 3: via-points (x, y, yaw) of a
      reference push: start of the tool, behind the box, and touching the box at the goal;
    * ``progress`` 1 in [0, 1]: share of the distance to the goal that is covered; ``success`` 1 (bool);
    * ``reward_terms``: the reward groups of :mod:`ppt_rl.envs.push.rewards`, whose sum is the reward.

    MuJoCo has one friction coefficient per contact. It is the kinetic one; static friction is not modelled.

    Args:
        num_envs: number of environments.
        goal: ``"position"``, as in the paper, or ``"pose"``.
        box_sizes: edge lengths of the boxes to draw from [m], 0.03 to 0.2.
        box_masses: mass of each of them [kg], 0.01 to 3; None takes the paper's, which has 0.06 m (50 g) and 0.08 m
            (80 g).
        randomisation: ranges of what is drawn for each episode.
        rewards: weights of the reward terms.
        reference: shape of the reference push; None takes the defaults.
        success_radius: largest distance from box to goal that counts as success [m].
        success_yaw: largest difference in yaw that counts as success [rad].
        **kwargs: as for :class:`ArmEnv`.

    Raises:
        ValueError: if a box has no known mass, a number is out of range, or a box may start inside the tool.

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
        goal: PushGoal = "position",
        box_sizes: Sequence[float] = (0.06, 0.08),
        box_masses: Sequence[float] | None = None,
        randomisation: PushRandomisation | None = None,
        rewards: PushRewards | None = None,
        reference: PushReference | None = None,
        success_radius: float = 0.02,
        success_yaw: float = 0.2,
        **kwargs: Any,
    ) -> None:
        expected = "a distance above 0 m, at most 1 m"
        if not 0 < require_number("success_radius", success_radius, expected) <= 1:
            raise ValueError(f"success_radius is {success_radius}; expected {expected}.")
        if goal not in get_args(PushGoal):
            raise ValueError(f"goal is {shown(goal)}; expected one of {list(get_args(PushGoal))}.")
        self.goal = goal
        self.boxes = Boxes.of(box_sizes, box_masses)
        self.randomisation = PushRandomisation() if randomisation is None else randomisation
        self.rewards = PushRewards() if rewards is None else rewards
        require_instance("randomisation", self.randomisation, PushRandomisation)
        require_instance("rewards", self.rewards, PushRewards)
        self.reference = PushReference() if reference is None else reference
        require_instance("reference", self.reference, PushReference)
        self.success_radius = float(success_radius)
        self.success_yaw = require_within("success_yaw", success_yaw, (1e-6, 3.2, "rad"))
        check_start(self.boxes, self.randomisation, self.tool.half_extent, self.start_pose[2])
        super().__init__(num_envs, **kwargs)

    horizon_terminates = True

    # -- episode ------------------------------------------------------------------------------------------------------

    def _scene(self) -> Any:
        return push_scene(self.arm, self.tool, physics_dt=self.engine_config.physics_dt, movable_com=self._moves_com)

    @property
    def _moves_com(self) -> bool:
        return any(self.randomisation.com)

    def _prepare(self, model: Any) -> None:
        self._box_slice = sensor_span(model, "box_position", "box_orientation")
        self._episode = PushEpisodes(self.num_envs, self.dtype, self.place)

    @property
    def _written(self) -> tuple[str, ...]:  # type: ignore[override]
        fields = ("geom_size", "geom_friction", "body_mass", "body_inertia")
        return (*fields, "body_ipos") if self._moves_com else fields

    def _begin(self, rows: Tensor) -> Tensor:
        drawn = draw_episodes(self._generators, rows, self.randomisation, self.boxes)
        self._episode.write(rows, drawn)
        self.engine.write(rows, self._episode_parameters())
        pose = self._start_poses(rows)
        pose[:, :2] = drawn["tool"]
        half_yaw, zeros = 0.5 * drawn["yaw"], torch.zeros_like(drawn["goal"])
        box = [drawn["box"], 0.5 * drawn["size"], half_yaw.cos(), zeros, half_yaw.sin()]  # position and quaternion
        return torch.cat([self._arm_position(pose), *box], -1)

    def _episode_parameters(self) -> list[Parameter]:
        physical, name = self._episode.physical, (PUSH_BOX,)
        half, mass = physical["half"], physical["mass"]
        inertia = mass * (2 * half).square() / 6
        written = [
            Parameter("geom_size", name, half.expand(-1, 3).unsqueeze(1)),
            Parameter("geom_friction", name, physical["friction"].unsqueeze(1)),
            Parameter("body_mass", name, mass),
            Parameter("body_inertia", name, inertia.expand(-1, 3).unsqueeze(1)),
        ]
        return [*written, Parameter("body_ipos", name, physical["com"].unsqueeze(1))] if self._moves_com else written

    def _write_looks(self, model: Any, row: int) -> None:
        write_looks(model, float(self._episode.half[row]), pose=self.goal == "pose")
        mark, half_yaw = model.body("goal"), 0.5 * float(self._episode.goal_yaw[row])
        mark.pos[:2] = self._episode.goal[row].cpu().numpy()
        mark.quat[:] = math.cos(half_yaw), 0, 0, math.sin(half_yaw)

    def _task_reset(self, rows: Tensor) -> dict[str, Any]:
        episode, box = self._episode, self._sensors[:, self._box_slice]
        tool = self._sensors[:, self._readings.slices["pose"]]
        distances = self._distances(box, tool)
        episode.begin(rows, distances)
        episode.replace(rows, via_position=self._via_points(tool)[rows])
        success = self._success(box, distances, self._elapsed >= self.horizon)
        return self._task_observation(
            box, zero_rewards(self.num_envs, self.dtype, device=self.place), distances, success
        )

    def _success(self, box: Tensor, distances: PushDistances, ended: Tensor) -> Tensor:
        if none_true(ended):
            return torch.zeros_like(ended)
        there = ended & (distances.box_to_goal < self.success_radius) & self._is_flat(box)
        return there & (distances.yaw_error < self.success_yaw) if self.goal == "pose" else there

    def _task_step(self, observation: dict[str, Any], ended: Tensor) -> dict[str, Any]:
        episode, box = self._episode, self._sensors[:, self._box_slice]
        distances = self._distances(box, observation["pose"])
        success = self._success(box, distances, ended)
        terms = self._reward_terms(observation, distances, success, ended)
        episode.advance(distances)
        return self._task_observation(box, terms, distances, success) | {"reward": total_reward(terms)}

    # -- reward -------------------------------------------------------------------------------------------------------

    def _reward_terms(
        self, observation: dict[str, Any], distances: PushDistances, success: Tensor, ended: Tensor
    ) -> dict[str, Tensor]:
        """``(num_envs, 1)`` reward of each group."""
        episode, weights, dt = self._episode, self.rewards, self.control_dt
        wrench, twist = observation["wrench"], observation["twist"]
        before, first = episode.previous, episode.initial
        progress = reward.progress(
            weights, distance=distances.box_to_goal, previous=before.box_to_goal, initial=first.box_to_goal
        )
        if self.goal == "pose":
            progress += reward.turn(weights, error=distances.yaw_error, previous=before.yaw_error)
        if not none_true(ended):
            progress += reward.arrival(
                weights, distance=distances.box_to_goal, success=success, ended=ended, radius=self.success_radius
            )
            if self.goal == "pose":
                progress += reward.pose_arrival(
                    weights, distance=distances.box_to_goal, error=distances.yaw_error, ended=ended
                )
        approach = reward.free_space(
            weights, distance=distances.tool_to_box, previous=before.tool_to_box, initial=first.tool_to_box,
            touched=episode.touched,
        )  # fmt: skip
        force = torch.linalg.vector_norm(wrench[:, :3], dim=-1, keepdim=True)
        return {
            "progress": progress,
            "free_space": approach,
            "contact": reward.contact(weights, force=force, dt=dt),
            "power": work_penalty(weights.power, wrench=wrench, twist=twist, dt=dt),
        }

    def _distances(self, box: Tensor, tool: Tensor) -> PushDistances:
        norm, episode, place = torch.linalg.vector_norm, self._episode, box[:, :2]
        return PushDistances(
            box_to_goal=norm(episode.goal - place, dim=-1, keepdim=True),
            tool_to_box=norm(tool[:, :2] - place, dim=-1, keepdim=True),
            yaw_error=_yaw_between(box[:, 3:7], episode.goal_yaw) if self.goal == "pose" else episode.initial.yaw_error,
        )

    def _is_flat(self, box: Tensor) -> Tensor:
        x, y = box[:, 4:5], box[:, 5:6]
        upright = 1 - 2 * (x * x + y * y) > _FLAT_COSINE  # cosine of the angle between the box's and the world's z axis
        return upright & ((box[:, 2:3] - self._episode.half).abs() < _FLAT_HEIGHT)

    # -- observations -------------------------------------------------------------------------------------------------

    def _via_points(self, tool: Tensor) -> Tensor:
        """``(num_envs, 3, 3)`` via-points (x, y, yaw) of the reference push [m, rad]."""
        episode = self._episode
        return push_via_points(
            self.reference,
            tool=tool[:, :2],
            box=episode.box_start,
            goal=episode.goal,
            goal_yaw=episode.goal_yaw if self.goal == "pose" else None,
            offset=episode.half + self.tool.half_thickness,
        )

    def _task_observation(
        self, box: Tensor, terms: dict[str, Tensor], distances: PushDistances, success: Tensor
    ) -> dict[str, Any]:
        episode = self._episode
        turned = {"goal_yaw": episode.goal_yaw, "yaw_error": distances.yaw_error} if self.goal == "pose" else {}
        left = distances.box_to_goal / episode.initial.box_to_goal
        return turned | {
            "box_pose": box,
            "box_start": episode.box_start,
            "box_size": constant(2.0, episode.half) * episode.half,
            "goal": episode.goal,
            "via_phase": episode.via_phase,
            "via_position": episode.via_position,
            "via_cov": episode.via_cov,
            "via_mask": episode.via_mask,
            "progress": (constant(1.0, left) - left).clamp(0.0, 1.0),
            "success": success,
            "reward_terms": terms,
        }

    def _task_spec(self, make: SpecMaker) -> Composite:
        real, flag = make.real, make.flag
        turned = {"goal_yaw": real(1), "yaw_error": real(1)} if self.goal == "pose" else {}
        return make.nest(
            **turned,
            box_pose=real(7), box_start=real(2), box_size=real(1), goal=real(2), via_phase=real(3),
            via_position=real(3, 3), via_cov=real(3, 3, 3), via_mask=flag(3), progress=real(1), success=flag(),
            reward_terms=reward_spec(make),
        )  # fmt: skip


def _yaw_between(orientation: Tensor, yaw: Tensor) -> Tensor:
    """``(B, 1)`` size of the difference between the yaw of a quaternion ``(B, 4)`` and ``yaw`` ``(B, 1)`` [rad]."""
    w, x, y, z = orientation.split(1, -1)
    error = torch.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)) - yaw
    return torch.remainder(error + math.pi, 2 * math.pi).sub_(math.pi).abs_()
