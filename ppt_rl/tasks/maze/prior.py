"""The hand-written follower behind the tank and the impedance, and the prior that is fitted to its rollouts."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor
from torchrl.envs import Compose, TransformedEnv

from ppt_rl.envs.maze import MazeEnv
from ppt_rl.functional.heading import to_heading
from ppt_rl.modules.kinematics import Kinematics
from ppt_rl.modules.promp import ProMP
from ppt_rl.tasks.config import damping_key, make_controller, motor_tank, wrench_law
from ppt_rl.tasks.maze.config import MazeConfig, maze_metrics, maze_space
from ppt_rl.tasks.maze.environments import make_training_env
from ppt_rl.tasks.maze.follower import WallFollower
from ppt_rl.transforms.energy_tank import EnergyTankTransform
from ppt_rl.transforms.episode_metrics import EpisodeMetricsTransform
from ppt_rl.transforms.heading_frame import HeadingFrameTransform
from ppt_rl.transforms.impedance import ImpedanceTransform
from ppt_rl.transforms.joint_torque import JointTorqueTransform

__all__ = ["fit_maze_prior", "make_follower", "make_follower_env"]

#: Length of a rollout, in durations of the primitive.
_PRIMITIVES = 6


def make_follower(config: MazeConfig) -> WallFollower:
    """The hand-written baseline with the recipe's depth and speed; it learns nothing.

    Args:
        config: options of the recipe.

    Returns:
        The follower, for :func:`make_follower_env`.
    """
    return WallFollower(maze_space(), lead=config.follower_lead, speed=config.follower_speed, depth=config.depth)


def make_follower_env(config: MazeConfig, base: MazeEnv) -> TransformedEnv:
    """The environment of the hand-written baseline: references, behind the policies' tank and impedance.

    Args:
        config: options of the recipe.
        base: bare environment with corridors or mazes.

    Returns:
        The environment.
    """
    mode, damping = config.tank_mode, damping_key(config.tank_mode)
    kinematics = Kinematics(base.arm, base.tool_length)
    return TransformedEnv(
        base,
        Compose(
            motor_tank(config.p_max, config.e_max, mode, base.arm),
            JointTorqueTransform(kinematics, posture_stiffness=config.posture_stiffness, damping_key=damping),
            EnergyTankTransform(config.p_max, config.e_max, flow_key="twist", **wrench_law(mode, base.arm)),
            ImpedanceTransform(make_controller(config), damping_key=damping),
            EpisodeMetricsTransform(maze_metrics(config)),
            HeadingFrameTransform(),
        ),
    )


@torch.no_grad()
def fit_maze_prior(promp: ProMP, config: MazeConfig, *, num_corridors: int = 64, seed: int = 0) -> ProMP:
    """Fit the prior of a maze primitive to rollouts of the hand-written follower in straight corridors.

    A demonstration is the tool's path over the primitive's duration, in heading axes relative to its start, lowered by
    the depth that presses the tool on the floor.

    Args:
        promp: a primitive with the coordinates of :data:`MAZE_AXES`; changed in place.
        config: options of the recipe.
        num_corridors: number of corridors.
        seed: seed of the corridors.

    Returns:
        The primitive.
    """
    seconds = max(config.training_duration, _PRIMITIVES * promp.duration)
    straight = replace(config, training_duration=seconds, train_in="corridors")
    base = make_training_env(straight, num_envs=num_corridors, seed=seed)
    env = make_follower_env(config, base)
    steps = round(promp.duration / config.control_dt)
    position, heading, alive = _rollout(env, make_follower(config), _PRIMITIVES * steps)
    env.close()
    demonstrations = []
    for begin in range(0, len(position) - steps, steps // 4):
        path = to_heading(position[begin : begin + steps + 1] - position[begin], heading[begin])
        path[..., 2] -= config.depth
        demonstrations.append(path[:, alive[begin + steps]].transpose(0, 1))
    promp.fit(torch.cat(demonstrations).double())
    return promp


def _rollout(env: TransformedEnv, follower: WallFollower, steps: int) -> tuple[Tensor, Tensor, Tensor]:
    """Positions ``(T, B, 3)``, headings ``(T, B, 1)`` and ``(T, B)`` whether the episode is still running."""
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
