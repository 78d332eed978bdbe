"""PPT in the maze: a receding ProMP along the heading, via-points from touch, energy tank, Cartesian impedance.

Trains on straight corridors only. With defaults, or look at the options: ``python recipes/ppo_ppt_maze.py --help``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from torch import nn
from torchrl.envs import Compose, TransformedEnv

from ppt_rl.envs import MazeLayout, MazeRanges
from ppt_rl.modules import Kinematics, ProMP
from ppt_rl.tasks import make_controller, prepare_torch
from ppt_rl.tasks.maze import (
    RecedingConfig,
    fit_maze_prior,
    make_maze_env,
    make_maze_policy,
    make_maze_promp,
    maze_metrics,
    maze_space,
)
from ppt_rl.training import run_recipe
from ppt_rl.transforms import (
    ContactViaPointTransform,
    EnergyTankTransform,
    EpisodeMetricsTransform,
    HeadingFrameTransform,
    ImpedanceTransform,
    JointTorqueTransform,
    MacroStepTransform,
    RecedingProMPTransform,
    ViaPointTransform,
)

VARIANT = "ppt_maze"


@dataclass(frozen=True)
class Config(RecedingConfig):
    """Train PPT (ProMP + PPO + energy tank) for the maze, on straight corridors."""

    run_dir: Path = Path("runs/ppt_maze")


def make_modules(config: Config) -> dict[str, ProMP]:
    """What a checkpoint holds besides the networks: the movement primitive, its prior not fitted yet."""
    return {"promp": make_maze_promp(config)}


def make_env(
    config: Config,
    promp: ProMP,
    *,
    num_envs: int | None = None,
    seed: int | None = None,
    audit: bool = False,
    ranges: MazeRanges | None = None,
    layouts: Sequence[MazeLayout] = (),
) -> TransformedEnv:
    """Straight corridors (or, with ranges or layouts, mazes) with PPT's chain; above the macro step: control rate."""
    base = make_maze_env(config, num_envs=num_envs, seed=seed, audit=audit, ranges=ranges, layouts=layouts)
    kinematics, dt = Kinematics(base.arm, base.tool_length), config.control_dt
    return TransformedEnv(
        base,
        Compose(
            JointTorqueTransform(kinematics, posture_stiffness=config.posture_stiffness, dt=dt),
            EnergyTankTransform(p_max=config.p_max, e_max=config.e_max, dt=dt),
            ImpedanceTransform(make_controller(config)),
            EpisodeMetricsTransform(maze_metrics(config)),
            HeadingFrameTransform(dt=dt),
            ContactViaPointTransform(config.promp_duration, dt=dt),
            MacroStepTransform(
                config.replan_steps,
                discount=config.ppo.gamma,
                interrupt_key="new_wall" if config.replan_on_contact else None,
            ),
            RecedingProMPTransform(
                promp,
                maze_space(),
                residual_scale=config.residual_scale,
                max_lead=(config.max_lead, 0.001, 0.0),
                max_slip=config.max_slip,
                replan_steps=config.replan_steps,
                dt=dt,
            ),
            ViaPointTransform(promp, frame=("pose", "heading")),
        ),
    )


def make_policy(config: Config, env: TransformedEnv) -> tuple[nn.Module, nn.Module]:
    """Actor and critic."""
    extra = ("contact", "tank_energy", "valve")
    return make_maze_policy(env, initial_scale=config.initial_scale, extra_keys=extra)


def main(config: Config) -> Path:
    """Train."""
    prepare_torch(config)
    modules = make_modules(config)
    fit_maze_prior(modules["promp"], config)  # from rollouts in straight corridors
    env = make_env(config, modules["promp"])
    return run_recipe(VARIANT, config, env, *make_policy(config, env), policy_steps=config.batch_steps, extra=modules)


if __name__ == "__main__":
    from ppt_rl.training import run_cli

    run_cli(main, Config)
