"""Maze sliding: a cylinder slides through a corridor that the robot knows only by touch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torchrl.data import Composite

from ppt_rl.arms import PANDA, Arm
from ppt_rl.envs.arm import ArmEnv
from ppt_rl.envs.maze import rewards as reward
from ppt_rl.envs.maze.episode import MazeEnd, MazeEpisodes, MazePosition
from ppt_rl.envs.maze.geometry import build_corridor
from ppt_rl.envs.maze.layout import MazeLayout
from ppt_rl.envs.maze.rewards import MazeRewards
from ppt_rl.envs.maze.sampling import MazeRanges, StraightRanges
from ppt_rl.envs.maze.scene import PIECE_NAMES, maze_scene
from ppt_rl.envs.maze.source import GivenMazes, RandomMazes, RandomStraights, Source
from ppt_rl.envs.maze.start import MazeRandomisation, draw_start
from ppt_rl.envs.models import CYLINDER
from ppt_rl.envs.physics import Parameter
from ppt_rl.envs.rewards import reward_spec, total_reward, work_penalty, zero_rewards
from ppt_rl.envs.specs import SpecMaker
from ppt_rl.functional.argument_checks import require_instance, require_number, shown

__all__ = ["MazeEnv"]

#: Error of the told heading in training. It exceeds every turn of the test mazes, so that a straight corridor with a
#: wrong heading looks like a turn [rad].
_TRAINING_HEADING = (-0.9, 0.9)
#: Random streams: with the same seed, training and test draw different numbers.
_STRAIGHT_STREAM, _MAZE_STREAM = 0, 1


class MazeEnv(ArmEnv):
    """Slide a cylinder through a corridor to its open end, without a map: the walls are known only by touch.

    Create it with :meth:`straight` (training), :meth:`mazes` (test) or :meth:`of` (your own layouts). Mazes are written
    into the compiled model, so every environment of a batch has its own maze, and a new one in each episode.

    An episode terminates when the end is reached (``success``), the tool leaves the corridor (``left_corridor``: its
    axis is beyond a wall, or its end is lifted over the walls) or the force exceeds ``max_force`` (``unsafe``). The
    observations are those of :class:`ArmEnv` and

    * ``start_heading`` 1 [rad]: heading of the corridor at its start, with an error, as the robot is told;
    * ``corridor_offset`` 1 [m] and ``corridor_heading`` 1 [rad]: offset of the tool to the left of the centre line, and
      direction of the centre line there; privileged, for critics;
    * ``progress`` 1 in [0, 1]: share of the centre line travelled; for metrics, never for a policy;
    * ``success``, ``left_corridor`` and ``unsafe`` 1 (bool);
    * ``reward_terms``: the reward groups of :mod:`ppt_rl.envs.maze.rewards`, whose sum is the reward.

    Args:
        num_envs: number of environments.
        source: draws the maze of an episode, given a random generator.
        stream: random stream; different streams draw different numbers with the same seed.
        randomisation: ranges of how an episode starts.
        rewards: weights of the reward terms.
        max_force: largest safe force at the wrist [N].
        duration: episode length [s].
        **kwargs: as for :class:`ArmEnv`.

    Raises:
        ValueError: if a number is out of range, or a maze has too many corners or pieces.

    Source:
        Paper, section "Maze Sliding".

    Examples:
        >>> env = MazeEnv.straight(2, seed=0)
        >>> env.reset()["start_heading"].shape
        torch.Size([2, 1])
    """

    tool = CYLINDER
    _written = ("geom_pos", "geom_quat", "geom_size", "pair_friction")

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
        if not callable(source):
            raise ValueError(
                f"source is {shown(source)}; expected a function that draws a MazeLayout. Use MazeEnv.straight, mazes "
                "or of."
            )
        if require_number("max_force", max_force, "a force above 0 N") <= 0:
            raise ValueError(f"max_force is {max_force}; expected a force above 0 N.")
        self._source, self._stream = source, stream
        self.randomisation = MazeRandomisation() if randomisation is None else randomisation
        self.rewards = MazeRewards() if rewards is None else rewards
        require_instance("randomisation", self.randomisation, MazeRandomisation)
        require_instance("rewards", self.rewards, MazeRewards)
        self.max_force = float(max_force)
        super().__init__(num_envs, duration=duration, **kwargs)

    @classmethod
    def straight(
        cls, num_envs: int = 1, *, ranges: StraightRanges | None = None, arm: Arm = PANDA, **kwargs: Any
    ) -> MazeEnv:
        """Training set: straight corridors at random positions and in random directions, with a wrong told heading.

        Args:
            num_envs: number of environments.
            ranges: ranges of the corridors.
            arm: the arm, which must reach the corridors.
            **kwargs: as for the class.

        Returns:
            The environment. None of its corridors has a turn.
        """
        kwargs.setdefault("randomisation", MazeRandomisation(heading_error=_TRAINING_HEADING))
        return cls(num_envs, RandomStraights(ranges, arm), stream=_STRAIGHT_STREAM, arm=arm, **kwargs)

    @classmethod
    def mazes(cls, num_envs: int = 1, *, ranges: MazeRanges | None = None, arm: Arm = PANDA, **kwargs: Any) -> MazeEnv:
        """Test set: mazes with turns, ramps and discs, from a random stream that training does not use.

        Args:
            num_envs: number of environments.
            ranges: ranges of the mazes.
            arm: the arm, which must reach the mazes.
            **kwargs: as for the class.

        Returns:
            The environment.
        """
        return cls(num_envs, RandomMazes(ranges, arm), arm=arm, **kwargs)

    @classmethod
    def of(
        cls, layouts: Sequence[MazeLayout], num_envs: int | None = None, *, arm: Arm = PANDA, **kwargs: Any
    ) -> MazeEnv:
        """Mazes of your own, used in turn.

        Args:
            layouts: the mazes; after the last one the first one follows again.
            num_envs: number of environments; None takes the number of layouts.
            arm: the arm, which must reach the mazes.
            **kwargs: as for the class.

        Returns:
            The environment.

        Raises:
            ValueError: if there is no layout, or one cannot be driven through.
        """
        source = GivenMazes(layouts, arm)
        return cls(len(layouts) if num_envs is None else num_envs, source, arm=arm, **kwargs)

    # -- episode ------------------------------------------------------------------------------------------------------

    def _scene(self) -> Any:
        return maze_scene(self.arm, self.tool, physics_dt=self.engine_config.physics_dt)

    def _prepare(self, model: Any) -> None:
        self._episode = MazeEpisodes(self.num_envs, self.dtype, self.place)
        self.layouts: list[MazeLayout | None] = [None] * self.num_envs

    def _begin(self, rows: Tensor) -> Tensor:
        positions, headings = [], []
        for row in rows.tolist():
            generator = self._generators[row]
            layout = self._source(generator)
            corridor = build_corridor(layout)
            self.layouts[row] = layout
            self._episode.write(row, corridor, layout.friction)
            positions.append(draw_start(generator, self.randomisation, layout, corridor, self.tool.stem_radius))
            headings.append(layout.heading + generator.uniform(*self.randomisation.heading_error))
        self._episode.begin(rows, np.asarray(headings))
        self.engine.write(rows, self._episode_parameters())
        pose = self._start_poses(rows)
        pose[:, :3] = torch.from_numpy(np.asarray(positions)).to(pose)
        return self._arm_position(pose)

    def _episode_parameters(self) -> list[Parameter]:
        position, orientation, size = self._episode.pieces.split((3, 4, 3), -1)
        friction = self._episode.friction.unsqueeze(-1)  # the same of every pair, in both directions
        return [
            Parameter("geom_pos", PIECE_NAMES, position),
            Parameter("geom_quat", PIECE_NAMES, orientation),
            Parameter("geom_size", PIECE_NAMES, size),
            Parameter("pair_friction", (), friction.expand(-1, len(PIECE_NAMES), 2)),
        ]

    def _task_reset(self, rows: Tensor) -> dict[str, Any]:
        position = self._episode.locate(self._sensors[:, self._readings.slices["pose"]])
        self._episode.measure_from(rows, position)
        nothing = MazeEnd(*(torch.zeros_like(self._episode.over) for _ in MazeEnd._fields))
        return self._task_observation(position, zero_rewards(self.num_envs, self.dtype, device=self.place), nothing)

    def _task_step(self, observation: dict[str, Any], ended: Tensor) -> dict[str, Any]:
        episode, pose = self._episode, observation["pose"]
        position = episode.locate(pose)
        end = episode.judge(position, pose[:, 2:3], observation["wrench"][:, :3], self.max_force)
        terms = self._reward_terms(observation, position, end)
        episode.advance(position, observation["twist"][:, :3], end)
        return self._task_observation(position, terms, end) | {"reward": total_reward(terms)}

    def _task_over(self) -> Tensor:
        return self._episode.over

    # -- reward -------------------------------------------------------------------------------------------------------

    def _reward_terms(self, observation: dict[str, Any], position: MazePosition, end: MazeEnd) -> dict[str, Tensor]:
        """``(num_envs, 1)`` reward of each group."""
        episode, weights, dt = self._episode, self.rewards, self.control_dt
        wrench, twist = observation["wrench"], observation["twist"]
        speed = torch.linalg.vector_norm(twist[:, :2], dim=-1, keepdim=True)
        acceleration = (twist[:, :3] - episode.velocity) / dt
        progress = reward.progress(
            weights, travelled=position.travelled, previous=episode.travelled, length=episode.length
        )
        contact = reward.contact(weights, force=wrench[:, :2], acceleration=acceleration, dt=dt)
        return {
            "progress": progress + reward.arrival(weights, success=end.success),
            "free_space": reward.free_space(weights, speed=speed, dt=dt),
            "contact": contact + reward.failure(weights, failed=end.failed),
            "power": work_penalty(weights.power, wrench=wrench, twist=twist, dt=dt),
        }

    # -- observations -------------------------------------------------------------------------------------------------

    def _task_observation(self, position: MazePosition, terms: dict[str, Tensor], end: MazeEnd) -> dict[str, Any]:
        return {
            "start_heading": self._episode.start_heading,
            "corridor_offset": position.offset,
            "corridor_heading": position.heading,
            "progress": (position.travelled / self._episode.length).clamp(0.0, 1.0),
            "success": end.success,
            "left_corridor": end.left_corridor,
            "unsafe": end.unsafe,
            "reward_terms": terms,
        }

    def _task_spec(self, make: SpecMaker) -> Composite:
        real, flag = make.real, make.flag
        return make.nest(
            start_heading=real(1), corridor_offset=real(1), corridor_heading=real(1), progress=real(1), success=flag(),
            left_corridor=flag(), unsafe=flag(), reward_terms=reward_spec(make),
        )  # fmt: skip
