"""ST in the maze: a step-wise Cartesian velocity along the heading, behind an energy tank.

Trains on straight corridors only. With defaults, or look at the options: ``python recipes/ppo_st_maze.py --help``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from torch import nn
from torchrl.envs import Transform, TransformedEnv

from ppt_rl.envs import MazeEnv, MazeRewards
from ppt_rl.evaluation import Recipe
from ppt_rl.modules import Kinematics
from ppt_rl.tasks import damping_key, make_controller, motor_tank, wrench_law
from ppt_rl.tasks.maze import MAZE, StepWiseMazeConfig, make_maze_policy, maze_metrics, maze_space
from ppt_rl.transforms import (
    CartesianVelocityTransform,
    EnergyTankTransform,
    EpisodeMetricsTransform,
    HeadingFrameTransform,
    ImpedanceTransform,
    JointTorqueTransform,
)


@dataclass(frozen=True)
class Config(StepWiseMazeConfig):
    """Train ST (step-wise PPO + energy tank) for the maze, on straight corridors.

    Attributes:
        rewards: weights that reward setting off: with PPT's, one of two policies learnt to creep.
    """

    run_dir: Path = Path("runs/st_maze")
    rewards: MazeRewards = field(
        default_factory=lambda: MazeRewards(progress=3.0, free_space=2.0, cruise=0.06, contact=3.0)
    )


def make_chain(config: Config, base: MazeEnv) -> list[Transform]:
    """ST's chain in the maze: everything runs at control rate."""
    kinematics = Kinematics(base.arm, base.tool_length)
    mode, damping = config.tank_mode, damping_key(config.tank_mode)
    return [
        motor_tank(config.p_max, config.e_max, mode, base.arm),
        JointTorqueTransform(kinematics, posture_stiffness=config.posture_stiffness, damping_key=damping),
        EnergyTankTransform(config.p_max, config.e_max, flow_key="twist", **wrench_law(mode, base.arm)),
        ImpedanceTransform(make_controller(config), damping_key=damping),
        EpisodeMetricsTransform(maze_metrics(config)),
        HeadingFrameTransform(),
        CartesianVelocityTransform(
            maze_space(), max_velocity=config.velocity, max_lead=config.lead, heading_key="heading"
        ),
    ]


def make_policy(config: Config, env: TransformedEnv) -> tuple[nn.Module, nn.Module]:
    """Actor and critic."""
    return make_maze_policy(env, initial_scale=config.initial_scale, extra_keys=("tank_energy", "valve"))


RECIPE = Recipe("st_maze", "ST", MAZE, Config, make_chain, make_policy, has_tank=True)

if __name__ == "__main__":
    RECIPE.main()
