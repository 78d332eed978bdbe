"""What the maze recipes have in common: options, environments, networks, the prior, the hand-written baseline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from torch import nn
from torchrl.envs import TransformedEnv

from ppt_rl.envs.maze import PandaMazeEnv
from ppt_rl.envs.maze.layout import MazeLayout
from ppt_rl.envs.maze.rewards import MazeRewards
from ppt_rl.envs.maze.sampling import MazeRanges
from ppt_rl.functional.metrics import MetricsConfig
from ppt_rl.modules.actor_critic import Mirror
from ppt_rl.modules.promp import ProMP
from ppt_rl.modules.task_space import TaskSpace
from ppt_rl.tasks.config import TaskConfig, episode_metrics
from ppt_rl.training.ppo import PPOConfig
from ppt_rl.training.recipe import make_actor_critic

__all__ = [
    "MAZE_AXES",
    "MAZE_PRIVILEGED",
    "MazeConfig",
    "RecedingConfig",
    "StepWiseMazeConfig",
    "make_maze_env",
    "make_maze_policy",
    "make_maze_promp",
    "maze_metrics",
    "maze_space",
]

#: Task-space coordinates in the maze; with a heading they are ahead, left and up.
MAZE_AXES = ("x", "y", "z")
#: What a policy may know: proprioception and wrench, along its heading.
_KNOWN = ("heading_twist", "heading_wrench")
#: A maze and its mirror image are alike: factors of twist and wrench along the heading, and of ahead, left and up.
_MIRRORED_TWIST, _MIRRORED_AXES = (1.0, -1.0, 1.0, -1.0, 1.0, -1.0), (1.0, -1.0, 1.0)
#: Observations that exist in simulation only; no evaluated policy sees them.
MAZE_PRIVILEGED = ("corridor_offset", "corridor_heading")
#: How far the basis reaches beyond phase 0 and 1, so that a straight line has no ripple there, and its overlap.
_MARGIN, _OVERLAP = 0.25, 0.7


@dataclass(frozen=True)
class MazeConfig(TaskConfig):
    """Options of every maze recipe.

    Attributes:
        training_duration: episode length in the straight corridors of training [s]; ``duration`` is that of the test.
        posture_stiffness: of the arm's posture in the nullspace [N m/rad]: low, since the maze takes the arm far.
        follower_speed: of the hand-written follower, which gives the demonstrations and is the baseline [m/s].
        follower_lead: of its reference ahead of the tool [m].
        e_max: capacity of the tank [J].
        cutoff: of the low-pass in the metrics of jerk and force [Hz].
        depth: of the reference below the tool, which presses it on the floor [m].
    """

    run_dir: Path = Path("runs/maze")
    num_envs: int = 64
    duration: float = 20.0
    training_duration: float = 6.0
    stiffness: float = 150.0
    posture_stiffness: float = 2.0
    follower_speed: float = 0.055
    follower_lead: float = 0.004
    e_max: float = 3.0
    cutoff: float = 10.0
    depth: float = 0.006
    ppo: PPOConfig = field(
        default_factory=lambda: PPOConfig(total_control_steps=614_400, max_learning_rate=5e-4, gamma=0.998)
    )


@dataclass(frozen=True)
class RecedingConfig(MazeConfig):
    """Options of the maze recipes whose policy acts on ProMP weights.

    Attributes:
        num_basis: basis functions of the ProMP for each of x, y and z.
        promp_duration: of the primitive [s].
        replan_steps: control steps between policy steps.
        residual_ahead: how far a residual of 1 moves a weight ahead [m].
        residual_left: to the left [m].
        residual_up: upwards [m].
        max_lead: how far ahead of the tool a primitive may begin [m].
        max_slip: how much faster or slower than the tool it may begin across wall and floor [m/s].
        replan_on_contact: whether a wall that is newly felt, or has turned, ends a chunk early.
        initial_scale: standard deviation of the untrained policy, in residuals [-].
        batch_steps: policy steps of every environment between two updates.
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

    @property
    def residual_scale(self) -> tuple[float, float, float]:
        """How far a residual of 1 moves a weight ahead, to the left and up [m]."""
        return self.residual_ahead, self.residual_left, self.residual_up


@dataclass(frozen=True)
class StepWiseMazeConfig(MazeConfig):
    """Options of the maze recipes whose policy acts on Cartesian velocity.

    Attributes:
        ppo: settings of PPO, with a horizon of two seconds: it starts from a tool that stands still.
        max_velocity: velocity of an action of 1 ahead and to the left [m/s].
        max_rise: velocity of an action of 1 upwards [m/s].
        max_lead: farthest the reference may be from the tool on the map [m].
        initial_scale: standard deviation of the untrained policy, in actions [-].
        batch_steps: control steps of every environment between two updates.
    """

    max_velocity: float = 0.12
    max_rise: float = 0.03
    max_lead: float = 0.02
    initial_scale: float = 0.1
    batch_steps: int = 64
    ppo: PPOConfig = field(
        default_factory=lambda: PPOConfig(total_control_steps=614_400, max_learning_rate=5e-4, gamma=0.995)
    )

    @property
    def velocity(self) -> tuple[float, float, float]:
        """Velocity of an action of 1 ahead, to the left and up [m/s]."""
        return self.max_velocity, self.max_velocity, self.max_rise

    @property
    def lead(self) -> tuple[float, float, float]:
        """Farthest the reference may be from the tool in x, y and z [m]."""
        return self.max_lead, self.max_lead, 2 * self.depth


def make_maze_env(
    config: MazeConfig,
    *,
    num_envs: int | None = None,
    seed: int | None = None,
    audit: bool = False,
    ranges: MazeRanges | None = None,
    layouts: Sequence[MazeLayout] = (),
    rewards: MazeRewards | None = None,
) -> PandaMazeEnv:
    """The bare environment of a maze recipe: straight corridors to train in, or mazes to be tested in.

    Args:
        config: the recipe's options.
        num_envs: instead of the configured number.
        seed: instead of the configured one.
        audit: whether power and work are measured at the physics' rate too.
        ranges: of the mazes of the test; None makes the straight corridors of training.
        layouts: mazes to take in turn instead.
        rewards: weights of the reward groups; by default those that PPT learns from.

    Returns:
        The environment.
    """
    common: dict[str, Any] = {
        "num_envs": num_envs or config.num_envs,
        "physics_dt": config.physics_dt,
        "control_dt": config.control_dt,
        "num_threads": config.num_threads or None,
        "seed": config.seed if seed is None else seed,
        "audit": audit,
        "rewards": rewards,
    }
    if layouts:
        return PandaMazeEnv.of(layouts, duration=config.duration, **common)
    if ranges is None:
        return PandaMazeEnv.straight(duration=config.training_duration, **common)
    return PandaMazeEnv.mazes(ranges=ranges, duration=config.duration, **common)


def maze_space() -> TaskSpace:
    """The task space of the maze: the tool upright, wherever it goes."""
    return TaskSpace(MAZE_AXES, PandaMazeEnv.start_pose)


def make_maze_promp(config: RecedingConfig) -> ProMP:
    """The movement primitive of a maze recipe, its prior not fitted yet.

    Args:
        config: the recipe's options.

    Returns:
        The primitive: its centres reach beyond phase 0 and 1, so that it can go straight at both ends.
    """
    centres = torch.linspace(-_MARGIN, 1 + _MARGIN, config.num_basis)
    width = _OVERLAP * (1 + 2 * _MARGIN) / (config.num_basis - 1)
    return ProMP(
        config.num_basis, len(MAZE_AXES), config.promp_duration, centres=centres,
        widths=torch.full_like(centres, width),
    )  # fmt: skip


def maze_metrics(config: MazeConfig) -> MetricsConfig:
    """Constants of the metrics of a maze recipe.

    Args:
        config: the recipe's options.

    Returns:
        The constants.
    """
    return replace(episode_metrics(config), cutoff=config.cutoff)


def make_maze_policy(
    env: TransformedEnv, *, initial_scale: float, extra_keys: Sequence[str] = ()
) -> tuple[nn.Module, nn.Module]:
    """Actor on proprioception and touch, the same to the left as to the right; critic on the place in the corridor too.

    Args:
        env: with the recipe's chain.
        initial_scale: standard deviation of the untrained policy [action units].
        extra_keys: observations that the recipe's transforms add, the same in a mirror.

    Returns:
        Actor and critic.
    """
    keys = [*_KNOWN, *extra_keys]
    same = sum(env.observation_spec[key].shape[-1] for key in extra_keys)
    per_axis = env.full_action_spec["action"].shape[-1] // len(MAZE_AXES)  # numbers of the action, axis by axis
    mirror = Mirror(
        (*_MIRRORED_TWIST * len(_KNOWN), *(1.0,) * same), [sign for sign in _MIRRORED_AXES for _ in range(per_axis)]
    )
    return make_actor_critic(
        env, keys, [*keys, "heading", *MAZE_PRIVILEGED], initial_scale=initial_scale, mirror=mirror
    )
