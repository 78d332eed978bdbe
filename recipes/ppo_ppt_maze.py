"""PPT in the maze: a receding ProMP along the heading, via-points from touch, energy tank, Cartesian impedance.

Trains on straight corridors only. With defaults, or look at the options: ``python recipes/ppo_ppt_maze.py --help``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from torch import nn
from torchrl.envs import Transform, TransformedEnv

from ppt_rl.envs import MazeEnv
from ppt_rl.evaluation import Recipe
from ppt_rl.modules import Kinematics, ProMP
from ppt_rl.tasks import damping_key, make_controller, motor_tank, wrench_law
from ppt_rl.tasks.maze import (
    MAZE,
    RecedingConfig,
    fit_maze_prior,
    make_maze_policy,
    make_maze_promp,
    maze_metrics,
    maze_space,
)
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


@dataclass(frozen=True)
class Config(RecedingConfig):
    """Train PPT (ProMP + PPO + energy tank) for the maze, on straight corridors."""

    run_dir: Path = Path("runs/ppt_maze")


def make_modules(config: Config) -> dict[str, ProMP]:
    """The movement primitive, its prior not fitted yet: what a checkpoint holds besides the networks."""
    return {"promp": make_maze_promp(config)}


def make_chain(config: Config, base: MazeEnv, promp: ProMP) -> list[Transform]:
    """PPT's chain in the maze: what stands above the macro step runs at control rate."""
    kinematics = Kinematics(base.arm, base.tool_length)
    mode, damping = config.tank_mode, damping_key(config.tank_mode)
    return [
        motor_tank(config.p_max, config.e_max, mode, base.arm),
        JointTorqueTransform(kinematics, posture_stiffness=config.posture_stiffness, damping_key=damping),
        EnergyTankTransform(config.p_max, config.e_max, flow_key="twist", **wrench_law(mode, base.arm)),
        ImpedanceTransform(make_controller(config), damping_key=damping),
        EpisodeMetricsTransform(maze_metrics(config)),
        HeadingFrameTransform(),
        ContactViaPointTransform(config.promp_duration),
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
        ),
        ViaPointTransform(promp, frame=("pose", "heading")),
    ]


def make_policy(config: Config, env: TransformedEnv) -> tuple[nn.Module, nn.Module]:
    """Actor and critic."""
    extra = ("contact", "tank_energy", "valve")
    return make_maze_policy(env, initial_scale=config.initial_scale, extra_keys=extra)


def fit(config: Config, promp: ProMP) -> None:
    """Fit the prior to rollouts of the wall follower in straight corridors."""
    fit_maze_prior(promp, config)


RECIPE = Recipe(
    "ppt_maze", "PPT", MAZE, Config, make_chain, make_policy, make_modules, fit,
    has_tank=True, has_reference=True, trace=("via_position", "via_mask"),
)  # fmt: skip

if __name__ == "__main__":
    RECIPE.main()
