"""What the maze recipes have in common: options, environments, networks, the prior, the hand-written baseline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torchrl.envs import Compose, TransformedEnv

from ppt_rl.envs.maze import PandaMazeEnv
from ppt_rl.envs.models import MazeLayout, MazeRanges
from ppt_rl.functional.heading import to_heading
from ppt_rl.functional.metrics import MetricsConfig
from ppt_rl.modules.kinematics import PandaKinematics
from ppt_rl.modules.promp import ProMP
from ppt_rl.modules.task_space import TaskSpace
from ppt_rl.training.config import TaskConfig, make_controller
from ppt_rl.training.ppo import PPOConfig
from ppt_rl.training.recipe import make_actor_critic
from ppt_rl.training.wall_follower import WallFollower
from ppt_rl.transforms.energy_tank import EnergyTankTransform
from ppt_rl.transforms.episode_metrics import EpisodeMetricsTransform
from ppt_rl.transforms.heading_frame import HeadingFrameTransform
from ppt_rl.transforms.impedance import ImpedanceTransform
from ppt_rl.transforms.joint_torque import JointTorqueTransform

__all__ = [
    "MAZE_AXES",
    "MAZE_PRIVILEGED",
    "MazeConfig",
    "RecedingConfig",
    "StepWiseMazeConfig",
    "fit_maze_prior",
    "make_follower",
    "make_follower_env",
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
#: Observations that exist in simulation only; no evaluated policy sees them.
MAZE_PRIVILEGED = ("corridor_offset", "corridor_heading")
#: How far the basis reaches beyond phase 0 and 1, so that a straight line has no ripple there, and its overlap.
_MARGIN, _OVERLAP = 0.25, 0.7
#: How long a demonstration is driven, in durations of the primitive.
_DRIVE = 6


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
        default_factory=lambda: PPOConfig(total_control_steps=614_400, max_learning_rate=5e-4, gamma=0.995)
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
        replan_on_contact: whether a wall that is newly felt ends a chunk early.
        initial_scale: standard deviation of the untrained policy, in residuals [-].
        batch_steps: policy steps of every environment between two updates.
    """

    num_basis: int = 8
    promp_duration: float = 0.8
    replan_steps: int = 20
    residual_ahead: float = 0.01
    residual_left: float = 0.01
    residual_up: float = 0.002
    max_lead: float = 0.002
    replan_on_contact: bool = True
    initial_scale: float = 0.1
    batch_steps: int = 20

    @property
    def residual_scale(self) -> tuple[float, float, float]:
        """How far a residual of 1 moves a weight ahead, to the left and up [m]."""
        return self.residual_ahead, self.residual_left, self.residual_up


@dataclass(frozen=True)
class StepWiseMazeConfig(MazeConfig):
    """Options of the maze recipes whose policy acts on Cartesian velocity.

    Attributes:
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
) -> PandaMazeEnv:
    """The bare environment of a maze recipe: straight corridors to train in, or mazes to be tested in.

    Args:
        config: the recipe's options.
        num_envs: instead of the configured number.
        seed: instead of the configured one.
        audit: whether power and work are measured at the physics' rate too.
        ranges: of the mazes of the test; None makes the straight corridors of training.
        layouts: mazes to take in turn instead.

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
    return MetricsConfig(dt=config.control_dt, p_max=config.p_max, cutoff=config.cutoff)


def make_follower(config: MazeConfig) -> WallFollower:
    """The hand-written baseline, with the recipe's impedance, depth and speed; it learns nothing.

    Args:
        config: the recipe's options.

    Returns:
        The follower, for :func:`make_follower_env`.
    """
    return WallFollower(maze_space(), lead=config.follower_lead, speed=config.follower_speed, depth=config.depth)


def make_follower_env(config: MazeConfig, base: PandaMazeEnv) -> TransformedEnv:
    """What the hand-written baseline acts on: references, behind the same tank and impedance as the policies.

    Args:
        config: the recipe's options.
        base: corridors or mazes.

    Returns:
        The environment.
    """
    kinematics, dt = PandaKinematics(base.tool_length), config.control_dt
    return TransformedEnv(
        base,
        Compose(
            JointTorqueTransform(kinematics, posture_stiffness=config.posture_stiffness, dt=dt),
            EnergyTankTransform(p_max=config.p_max, e_max=config.e_max, dt=dt),
            ImpedanceTransform(make_controller(config)),
            EpisodeMetricsTransform(maze_metrics(config)),
            HeadingFrameTransform(dt=dt),
        ),
    )


@torch.no_grad()
def fit_maze_prior(promp: ProMP, config: MazeConfig, *, num_corridors: int = 64, seed: int = 0) -> ProMP:
    """Fit the prior of a maze primitive to rollouts of the hand-written follower in straight corridors.

    A demonstration is the way of the tool over the primitive's duration, in heading axes from where it began, set lower
    by the depth that presses the tool on the floor.

    Args:
        promp: a primitive with the coordinates of :data:`MAZE_AXES`; changed in place.
        config: the recipe's options.
        num_corridors: how many are driven through.
        seed: of the corridors.

    Returns:
        The primitive.
    """
    seconds = max(config.training_duration, _DRIVE * promp.duration)
    base = make_maze_env(replace(config, training_duration=seconds), num_envs=num_corridors, seed=seed)
    env = make_follower_env(config, base)
    steps = round(promp.duration / config.control_dt)
    position, heading, alive = _driven(env, make_follower(config), _DRIVE * steps)
    env.close()
    demonstrations = []
    for begin in range(0, len(position) - steps, steps // 4):
        way = to_heading(position[begin : begin + steps + 1] - position[begin], heading[begin])
        way[..., 2] -= config.depth
        demonstrations.append(way[:, alive[begin + steps]].transpose(0, 1))
    promp.fit(torch.cat(demonstrations).double())
    return promp


def _driven(env: TransformedEnv, follower: WallFollower, steps: int) -> tuple[Tensor, Tensor, Tensor]:
    """Positions ``(T, B, 3)``, headings ``(T, B, 1)`` and whether the episode goes on ``(T, B)``."""
    tensordict, alive = env.reset(), torch.ones(env.batch_size, dtype=torch.bool)
    positions, headings, flags = [], [], []
    for _ in range(steps):
        positions.append(tensordict["pose"][..., :3])
        headings.append(tensordict["heading"])
        flags.append(alive)
        tensordict = env.step(follower(tensordict))
        alive = alive & ~tensordict["next", "done"].squeeze(-1)
        tensordict = env.step_mdp(tensordict)
    return torch.stack(positions), torch.stack(headings), torch.stack(flags)


def make_maze_policy(
    env: TransformedEnv, *, initial_scale: float, extra_keys: Sequence[str] = ()
) -> tuple[nn.Module, nn.Module]:
    """Actor on proprioception and touch, critic on the place in the corridor as well.

    Args:
        env: with the recipe's chain.
        initial_scale: standard deviation of the untrained policy [action units].
        extra_keys: observations that the recipe's transforms add.

    Returns:
        Actor and critic.
    """
    keys = [*_KNOWN, *extra_keys]
    return make_actor_critic(env, keys, [*keys, "heading", *MAZE_PRIVILEGED], initial_scale=initial_scale)
