"""Options, task space and movement primitive of the maze recipes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, Literal, get_args

import torch
from torch import Tensor

from ppt_rl.envs import MazeEnv, MazeRanges, MazeRewards, StraightRanges
from ppt_rl.functional.argument_checks import shown
from ppt_rl.functional.checks import Bounds
from ppt_rl.functional.metrics import MetricsConfig
from ppt_rl.modules.promp import ProMP
from ppt_rl.modules.task_space import TaskSpace
from ppt_rl.tasks.config import TaskConfig, episode_metrics
from ppt_rl.training import PPOConfig

__all__ = [
    "MAZE_AXES",
    "MazeConfig",
    "RecedingConfig",
    "StepWiseMazeConfig",
    "make_maze_promp",
    "maze_metrics",
    "maze_space",
    "velocity_map",
]

#: Where a maze policy trains.
TrainingGround = Literal["corridors", "mazes"]
#: Task-space coordinates in the maze; with a heading they are ahead, left and up.
MAZE_AXES = ("x", "y", "z")
#: How far the basis reaches beyond phase 0 and 1, so that it can represent a straight line without ripple; its overlap.
_MARGIN, _OVERLAP = 0.25, 0.7


@dataclass(frozen=True)
class MazeConfig(TaskConfig):
    """Options of every maze recipe.

    Attributes:
        train_in: where a policy trains: in straight corridors, or in random mazes, other ones than those of the test.
        training_duration: episode length in training [s]; ``duration`` is that of the test.
        heading_error: largest error of the heading that is told in a training corridor [rad]; the default exceeds every
            turn of the default mazes, so that a straight corridor with a wrong heading looks like a turn.
        posture_stiffness: stiffness of the arm's posture in the nullspace [N m/rad]; low, since the maze takes the arm
            far from its home.
        follower_speed: speed of the hand-written follower, which is the baseline and gives the demonstrations [m/s].
        follower_lead: distance of its reference ahead of the tool [m].
        e_max: capacity of the tank [J].
        tank_mode: law of the tanks: paper, passive, parallel, rate or impact.
        cutoff: cutoff of the low-pass in the metrics of jerk and force [Hz].
        depth: distance of the reference below the tool, which presses it on the floor [m].
        layouts: JSON files of mazes to be judged in, taken in turn; with none, mazes are drawn at random.
        rewards: weights of the reward terms.
        mazes: ranges of the random mazes.
        corridors: ranges of the straight corridors.
    """

    run_dir: Path = Path("runs/maze")
    num_envs: int = 64
    duration: float = 20.0
    train_in: TrainingGround = "corridors"
    training_duration: float = 6.0
    heading_error: float = 0.9
    stiffness: float = 150.0
    posture_stiffness: float = 2.0
    follower_speed: float = 0.055
    follower_lead: float = 0.004
    e_max: float = 3.0
    tank_mode: str = "paper"
    cutoff: float = 10.0
    depth: float = 0.006
    layouts: tuple[Path, ...] = ()
    rewards: MazeRewards = field(default_factory=MazeRewards)
    mazes: MazeRanges = field(default_factory=MazeRanges)
    corridors: StraightRanges = field(default_factory=StraightRanges)
    ppo: PPOConfig = field(
        default_factory=lambda: PPOConfig(total_control_steps=614_400, max_learning_rate=5e-4, gamma=0.998)
    )

    bounds: ClassVar[dict[str, Bounds]] = {
        "training_duration": Bounds(1e-3, 600.0, "s"),
        "heading_error": Bounds(0.0, math.pi, "rad"),
        "posture_stiffness": Bounds(0.0, 1e4, "N m/rad"),
        "follower_speed": Bounds(1e-4, 10.0, "m/s"),
        "follower_lead": Bounds(1e-6, 1.0, "m"),
        "cutoff": Bounds(1e-3, 1e4, "Hz"),
        "depth": Bounds(0.0, 1.0, "m"),
        "max_lead": Bounds(1e-6, 10.0, "m"),
    }

    def __post_init__(self) -> None:
        """Refuse an unknown training ground and numbers out of bounds."""
        if self.train_in not in get_args(TrainingGround):
            raise ValueError(f"train_in is {shown(self.train_in)}; expected one of {list(get_args(TrainingGround))}.")
        super().__post_init__()


@dataclass(frozen=True)
class RecedingConfig(MazeConfig):
    """Options of the maze recipes whose policy acts on ProMP weights.

    Attributes:
        num_basis: number of basis functions of the ProMP for each of x, y and z.
        promp_duration: duration of the primitive [s].
        replan_steps: control steps from one policy step to the next.
        residual_ahead: change of a weight ahead per unit of residual [m].
        residual_left: change of a weight to the left per unit of residual [m].
        residual_up: change of a weight upwards per unit of residual [m].
        max_lead: largest distance ahead of the tool at which a primitive may begin [m].
        max_slip: largest difference of the primitive's initial velocity from the tool's, across wall and floor [m/s].
        replan_on_contact: whether a newly felt wall, or one that has turned, ends a chunk early.
        initial_scale: standard deviation of the untrained policy, in residuals [-].
        batch_steps: policy steps of every environment in a batch.
    """

    num_basis: int = 8
    promp_duration: float = 0.8
    replan_steps: int = 15
    residual_ahead: float = 0.01
    residual_left: float = 0.01
    residual_up: float = 0.002
    max_lead: float = 0.006
    max_slip: float = 0.0025
    replan_on_contact: bool = True
    initial_scale: float = 0.1
    batch_steps: int = 40

    bounds: ClassVar[dict[str, Bounds]] = {
        "promp_duration": Bounds(1e-3, 600.0, "s"),
        "replan_steps": Bounds(1, 1000, "control steps"),
        "residual_ahead": Bounds(0.0, 10.0, "m"),
        "residual_left": Bounds(0.0, 10.0, "m"),
        "residual_up": Bounds(0.0, 10.0, "m"),
        "max_slip": Bounds(0.0, 10.0, "m/s"),
    }

    @property
    def residual_scale(self) -> tuple[float, float, float]:
        """Change of a weight ahead, to the left and up per unit of residual [m]."""
        return self.residual_ahead, self.residual_left, self.residual_up


@dataclass(frozen=True)
class StepWiseMazeConfig(MazeConfig):
    """Options of the maze recipes whose policy acts on Cartesian velocity.

    Attributes:
        ppo: settings of PPO; its horizon is two seconds, since training starts from a tool at rest.
        max_velocity: velocity of an action of 1 ahead and to the left [m/s].
        max_rise: velocity of an action of 1 upwards [m/s].
        max_lead: largest horizontal distance of the reference from the tool [m].
        initial_scale: standard deviation of the untrained policy, in actions [-].
        batch_steps: control steps of every environment in a batch.
    """

    max_velocity: float = 0.12
    max_rise: float = 0.03
    max_lead: float = 0.02
    initial_scale: float = 0.1
    batch_steps: int = 64
    ppo: PPOConfig = field(
        default_factory=lambda: PPOConfig(total_control_steps=614_400, max_learning_rate=5e-4, gamma=0.995)
    )

    bounds: ClassVar[dict[str, Bounds]] = {
        "max_velocity": Bounds(1e-6, 100.0, "m/s"),
        "max_rise": Bounds(1e-6, 100.0, "m/s"),
    }

    @property
    def velocity(self) -> tuple[float, float, float]:
        """Velocity of an action of 1 ahead, to the left and up [m/s]."""
        return self.max_velocity, self.max_velocity, self.max_rise

    @property
    def lead(self) -> tuple[float, float, float]:
        """Largest distance of the reference from the tool in x, y and z [m]."""
        return self.max_lead, self.max_lead, 2 * self.depth


def maze_space() -> TaskSpace:
    """The task space of the maze: the position of a tool that stays upright."""
    return TaskSpace(MAZE_AXES, MazeEnv.start_pose)


def make_maze_promp(config: RecedingConfig) -> ProMP:
    """The movement primitive of a maze recipe, its prior not fitted yet.

    Args:
        config: the recipe's options.

    Returns:
        The primitive. Its centres reach beyond phase 0 and 1, so that it can go straight at both ends.
    """
    centres = torch.linspace(-_MARGIN, 1 + _MARGIN, config.num_basis)
    width = _OVERLAP * (1 + 2 * _MARGIN) / (config.num_basis - 1)
    return ProMP(
        config.num_basis, len(MAZE_AXES), config.promp_duration, centres=centres,
        widths=torch.full_like(centres, width),
    )  # fmt: skip


def velocity_map(promp: ProMP) -> Tensor:
    """What a velocity ahead, to the left and up adds to the weights of a maze primitive.

    Args:
        promp: the primitive.

    Returns:
        ``(K * D, D)``, for an :class:`~ppt_rl.transforms.ActionMapTransform`: a unit moves each weight by the phase of
        its centre, and so the trajectory in proportion to time.
    """
    return torch.block_diag(*[promp.centres.unsqueeze(-1)] * promp.num_dof)


def maze_metrics(config: MazeConfig) -> MetricsConfig:
    """Constants of the metrics of a maze recipe.

    Args:
        config: the recipe's options.

    Returns:
        The constants.
    """
    return replace(episode_metrics(config), cutoff=config.cutoff)
