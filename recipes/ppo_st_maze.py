"""ST in the maze: a step-wise Cartesian velocity along the heading, behind an energy tank.

Trains on straight corridors only. With defaults, or look at the options: ``python recipes/ppo_st_maze.py --help``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from torch import nn
from torchrl.envs import Compose, TransformedEnv

from ppt_rl.envs import MazeLayout, MazeRanges, MazeRewards
from ppt_rl.modules import Kinematics
from ppt_rl.tasks import make_controller, prepare_torch
from ppt_rl.tasks.maze import StepWiseMazeConfig, make_maze_env, make_maze_policy, maze_metrics, maze_space
from ppt_rl.training import run_recipe
from ppt_rl.transforms import (
    CartesianVelocityTransform,
    EnergyTankTransform,
    EpisodeMetricsTransform,
    HeadingFrameTransform,
    ImpedanceTransform,
    JointTorqueTransform,
)

VARIANT = "st_maze"
#: Weights that reward setting off: with PPT's former ones, one of two policies crept (with these one floats instead).
REWARDS = MazeRewards(progress=3.0, free_space=2.0, cruise=0.06, contact=3.0)


@dataclass(frozen=True)
class Config(StepWiseMazeConfig):
    """Train ST (step-wise PPO + energy tank) for the maze, on straight corridors."""

    run_dir: Path = Path("runs/st_maze")


def make_modules(config: Config) -> dict[str, nn.Module]:
    """What a checkpoint holds besides the networks: nothing."""
    return {}


def make_env(
    config: Config,
    *,
    num_envs: int | None = None,
    seed: int | None = None,
    audit: bool = False,
    ranges: MazeRanges | None = None,
    layouts: Sequence[MazeLayout] = (),
) -> TransformedEnv:
    """Straight corridors (or, with ranges or layouts, mazes) with ST's chain: everything runs at control rate."""
    base = make_maze_env(
        config, num_envs=num_envs, seed=seed, audit=audit, ranges=ranges, layouts=layouts, rewards=REWARDS
    )
    kinematics, dt = Kinematics(base.arm, base.tool_length), config.control_dt
    return TransformedEnv(
        base,
        Compose(
            JointTorqueTransform(kinematics, posture_stiffness=config.posture_stiffness, dt=dt),
            EnergyTankTransform(p_max=config.p_max, e_max=config.e_max, dt=dt),
            ImpedanceTransform(make_controller(config)),
            EpisodeMetricsTransform(maze_metrics(config)),
            HeadingFrameTransform(dt=dt),
            CartesianVelocityTransform(
                maze_space(), max_velocity=config.velocity, max_lead=config.lead, dt=dt, heading_key="heading"
            ),
        ),
    )


def make_policy(config: Config, env: TransformedEnv) -> tuple[nn.Module, nn.Module]:
    """Actor and critic."""
    return make_maze_policy(env, initial_scale=config.initial_scale, extra_keys=("tank_energy", "valve"))


def main(config: Config) -> Path:
    """Train."""
    prepare_torch(config)
    env = make_env(config)
    return run_recipe(VARIANT, config, env, *make_policy(config, env), policy_steps=config.batch_steps)


if __name__ == "__main__":
    from ppt_rl.training import run_cli

    run_cli(main, Config)
