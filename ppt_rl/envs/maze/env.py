"""Maze sliding: a cylinder finds its way through a corridor by touch alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torchrl.data import Composite

from ppt_rl.arms import PANDA, Arm
from ppt_rl.envs.arm import ArmEnv, Rows
from ppt_rl.envs.maze import rewards as reward
from ppt_rl.envs.maze.episode import MazeEpisodes, MazePlace, MazeRandomisation
from ppt_rl.envs.maze.geometry import WALL_HEIGHT, Corridor, build_corridor, check_corridor
from ppt_rl.envs.maze.layout import MazeLayout, Straight
from ppt_rl.envs.maze.rewards import MazeRewards
from ppt_rl.envs.maze.sampling import MazeRanges, StraightRanges, random_maze, random_straight
from ppt_rl.envs.maze.scene import check_pieces, maze_scene, write_corridor
from ppt_rl.envs.models import CYLINDER
from ppt_rl.envs.rewards import reward_spec, total_reward, work_penalty, zero_rewards
from ppt_rl.envs.specs import SpecMaker

__all__ = ["MazeEnv"]

#: The robot is told a heading off by this much at most in training: as far as a turn of the test and more [rad].
_TRAINING_HEADING = (-0.9, 0.9)
#: A tool whose end is this high above the floor is out of the corridor [m].
_LIFTED = 0.8 * WALL_HEIGHT
#: Length of a first straight with room for the tool before the turn [m].
_FIRST = 0.055
#: Streams of randomness: a seed draws other corridors in training than mazes in the test.
_STRAIGHT_STREAM, _MAZE_STREAM = 0, 1

Source = Callable[[np.random.Generator], MazeLayout]


class MazeEnv(ArmEnv):
    """Slide a cylinder through a corridor to its open end, with no map: only touch tells where the walls are.

    Make it by :meth:`straight` (training), :meth:`mazes` (test) or :meth:`of` (layouts of your own). Mazes are written
    into the compiled model, so every environment of a batch has its own and a new one each episode.

    An episode is terminated where the end is reached (``success``), where the tool ``left_corridor`` (its axis beyond a
    wall's face, or its end lifted over the walls), or where the force is above ``max_force`` (``unsafe``). Adds to the
    observations of :class:`ArmEnv`:

    * ``start_heading`` 1 [rad]: of the corridor at its start, as the robot is told, with some error; known in the test;
    * ``corridor_offset`` 1 [m] and ``corridor_heading`` 1 [rad]: where the tool is in the corridor, to the left of its
      centre line, and where that leads: privileged, for critics;
    * ``progress`` 1 in [0, 1] along the centre line: for rewards and metrics, never for a policy;
    * ``success``, ``left_corridor``, ``unsafe`` 1 (bool), and the reward groups under ``reward_terms``.

    Args:
        num_envs: number of environments.
        source: draws the maze of an episode from a generator.
        stream: of the randomness; sources of other streams draw other numbers from the same seed.
        randomisation: ranges of how an episode starts.
        rewards: weights of the reward groups.
        max_force: largest safe force at the wrist [N].
        duration: episode length [s].
        **kwargs: as for :class:`ArmEnv`.

    Raises:
        ValueError: if a number is out of range, or a maze cannot be built.

    Source:
        Paper, section "Maze Sliding".

    Examples:
        >>> env = MazeEnv.straight(2, seed=0)
        >>> env.reset()["start_heading"].shape
        torch.Size([2, 1])
    """

    tool = CYLINDER

    def __init__(
        self,
        num_envs: int,
        source: Source,
        *,
        stream: int = _MAZE_STREAM,
        randomisation: MazeRandomisation | None = None,
        rewards: MazeRewards | None = None,
        max_force: float = 40.0,
        duration: float = 20.0,
        **kwargs: Any,
    ) -> None:
        if not max_force > 0:
            raise ValueError(f"max_force is {max_force}; expected a force above 0 N.")
        self._source, self._stream = source, stream
        self.randomisation = MazeRandomisation() if randomisation is None else randomisation
        self.rewards = MazeRewards() if rewards is None else rewards
        self.max_force = float(max_force)
        super().__init__(num_envs, duration=duration, **kwargs)

    @classmethod
    def straight(
        cls, num_envs: int = 1, *, ranges: StraightRanges | None = None, arm: Arm = PANDA, **kwargs: Any
    ) -> MazeEnv:
        """The training set: straight corridors in random places and directions, and a heading told badly.

        Args:
            num_envs: number of environments.
            ranges: of the corridors.
            arm: the arm, in whose reach they lie.
            **kwargs: as for the class.

        Returns:
            The environment. It cannot make a turn.
        """
        kwargs.setdefault("randomisation", MazeRandomisation(heading_error=_TRAINING_HEADING))
        return cls(num_envs, lambda rng: random_straight(rng, ranges, arm), stream=_STRAIGHT_STREAM, arm=arm, **kwargs)

    @classmethod
    def mazes(cls, num_envs: int = 1, *, ranges: MazeRanges | None = None, arm: Arm = PANDA, **kwargs: Any) -> MazeEnv:
        """The test set: mazes with turns, ramps and discs, of a stream of randomness that training never draws from.

        Args:
            num_envs: number of environments.
            ranges: of the mazes.
            arm: the arm, in whose reach they lie.
            **kwargs: as for the class.

        Returns:
            The environment.
        """
        return cls(num_envs, lambda rng: random_maze(rng, ranges, arm), arm=arm, **kwargs)

    @classmethod
    def of(
        cls, layouts: Sequence[MazeLayout], num_envs: int | None = None, *, arm: Arm = PANDA, **kwargs: Any
    ) -> MazeEnv:
        """Mazes written by hand.

        Args:
            layouts: taken in turn, from the first again after the last.
            num_envs: number of environments; None takes one for each layout.
            arm: the arm, in whose reach they must lie.
            **kwargs: as for the class.

        Returns:
            The environment.

        Raises:
            ValueError: if there is none, or one cannot be built.
        """
        if not layouts:
            raise ValueError("layouts are empty; expected at least one MazeLayout.")
        for layout in layouts:
            corridor = build_corridor(layout)
            check_corridor(corridor, layout, arm.reach)
            check_pieces(corridor)
            first = layout.segments[0]
            if isinstance(first, Straight) and first.length < _FIRST:
                raise ValueError(f"the first segment is {first}; expected at least {_FIRST} m, to start in.")
        position = iter(range(2**62))
        count = len(layouts) if num_envs is None else num_envs
        return cls(count, lambda _: layouts[next(position) % len(layouts)], arm=arm, **kwargs)

    # -- episode ------------------------------------------------------------------------------------------------------

    def _scene(self) -> Any:
        return maze_scene(self.arm, self.tool, physics_dt=self.engine_config.physics_dt)

    def _set_seed(self, seed: int | None) -> None:
        self._rng = np.random.default_rng(None if seed is None else [seed, self._stream])

    def _prepare(self, model: Any) -> None:
        self._episode = MazeEpisodes(self.num_envs, self.dtype)
        self.layouts: list[MazeLayout | None] = [None] * self.num_envs

    def _begin(self, rows: Rows) -> np.ndarray:
        poses, headings = [], []
        for row in rows:
            layout = self._source(self._rng)
            corridor = build_corridor(layout)
            self.layouts[row] = layout
            self._episode.write(int(row), corridor, layout.friction)
            self._write_parameters(self.engine.models[row], int(row))
            poses.append(self._start(layout, corridor))
            headings.append(layout.heading + self._rng.uniform(*self.randomisation.heading_error))
        self._episode.begin(rows, np.asarray(headings))
        return self._arm_position(torch.tensor(np.asarray(poses), dtype=torch.float64)).numpy()

    def _start(self, layout: MazeLayout, corridor: Corridor) -> np.ndarray:
        """Pose of the tool at the start: upright, its end a hair above the floor [m, -]."""
        ranges = self.randomisation
        room = 0.5 * layout.width - self.tool.stem_radius
        along, across = self._rng.uniform(*ranges.along), room * self._rng.uniform(*ranges.across)
        way = np.asarray([np.cos(layout.heading), np.sin(layout.heading)])
        place = corridor.centre[0, :2] + along * way + across * np.asarray([-way[1], way[0]])
        at = np.linalg.norm(corridor.centre[:, :2] - corridor.centre[0, :2], axis=1)  # of the first straight's corners
        reach = along + self.tool.stem_radius * np.linspace(-1.0, 1.0, 9)
        floor = np.interp(reach, at[:4], corridor.centre[:4, 2]).max()  # a first ramp may begin under the tool
        return np.concatenate([place, [floor + 5e-4], self.start_pose[3:]])

    def _write_parameters(self, model: Any, row: int) -> None:
        corridor = self._episode.corridors[row]
        if corridor is not None:
            write_corridor(model, corridor, float(self._episode.friction[row]))

    def _task_reset(self, rows: Tensor) -> dict[str, Any]:
        pose = self._sensors[:, self._readings.slices["pose"]]
        place = self._episode.locate(pose)
        self._episode.travelled = self._episode.travelled.clone()
        self._episode.travelled[rows] = place.travelled[rows]
        self._episode.velocity = self._episode.velocity.clone()
        self._episode.velocity[rows] = 0.0
        false = torch.zeros_like(self._episode.over)
        return self._task_observation(place, zero_rewards(self.num_envs, self.dtype), false, false, false)

    def _task_step(self, observation: dict[str, Any], ended: Tensor) -> dict[str, Any]:
        episode, pose = self._episode, observation["pose"]
        place = episode.locate(pose)
        success = place.travelled >= episode.length - 1e-4
        lifted = pose[:, 2:3] - place.floor > _LIFTED
        left = (place.offset.abs() > place.half_width) | lifted
        force = observation["wrench"][:, :3].square()
        unsafe = force.sum(-1, keepdim=True) > self.max_force**2
        failed = left | unsafe
        success = success & ~failed
        terms = self._reward_terms(observation, place, success, failed)
        episode.travelled, episode.velocity = place.travelled, observation["twist"][:, :3]
        episode.over = success | failed
        return self._task_observation(place, terms, success, left, unsafe) | {"reward": total_reward(terms)}

    def _task_over(self) -> Tensor:
        return self._episode.over

    # -- reward -------------------------------------------------------------------------------------------------------

    def _reward_terms(
        self, observation: dict[str, Any], place: MazePlace, success: Tensor, failed: Tensor
    ) -> dict[str, Tensor]:
        """``(num_envs, 1)`` reward of each group."""
        episode, weights, dt = self._episode, self.rewards, self.control_dt
        wrench, twist = observation["wrench"], observation["twist"]
        progress = reward.progress(
            weights, travelled=place.travelled, previous=episode.travelled, length=episode.length
        )
        speed = torch.linalg.vector_norm(twist[:, :2], dim=-1, keepdim=True)
        acceleration = (twist[:, :3] - episode.velocity) / dt
        contact = reward.contact(weights, force=wrench[:, :2], acceleration=acceleration, dt=dt)
        return {
            "progress": progress + reward.arrival(weights, success=success),
            "free_space": reward.free_space(weights, speed=speed, dt=dt),
            "contact": contact + reward.failure(weights, failed=failed),
            "power": work_penalty(weights.power, wrench=wrench, twist=twist, dt=dt),
        }

    # -- observations -------------------------------------------------------------------------------------------------

    def _task_observation(
        self, place: MazePlace, terms: dict[str, Tensor], success: Tensor, left: Tensor, unsafe: Tensor
    ) -> dict[str, Any]:
        return {
            "start_heading": self._episode.start_heading,
            "corridor_offset": place.offset,
            "corridor_heading": place.heading,
            "progress": (place.travelled / self._episode.length).clamp(0.0, 1.0),
            "success": success,
            "left_corridor": left,
            "unsafe": unsafe,
            "reward_terms": terms,
        }

    def _task_spec(self, make: SpecMaker) -> Composite:
        real, flag = make.real, make.flag
        return make.nest(
            start_heading=real(1), corridor_offset=real(1), corridor_heading=real(1), progress=real(1), success=flag(),
            left_corridor=flag(), unsafe=flag(), reward_terms=reward_spec(make),
        )  # fmt: skip
