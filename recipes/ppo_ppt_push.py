"""PPT on box pushing: ProMP residual policy, energy tank, Cartesian impedance.

Train with defaults, or look at the options: ``python recipes/ppo_ppt_push.py --help``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from torch import nn
from torchrl.envs import Transform, TransformedEnv

from ppt_rl.envs import PushEnv
from ppt_rl.evaluation import Recipe
from ppt_rl.functional.checks import Bounds
from ppt_rl.modules import Kinematics, ProMP, TaskSpace
from ppt_rl.tasks import damping_key, episode_metrics, make_controller, motor_tank, wrench_law
from ppt_rl.tasks.push import PUSH, PUSH_AXES, ByGoal, EpisodeLevelConfig, fit_push_prior, make_push_policy
from ppt_rl.transforms import (
    EnergyPenaltyTransform,
    EnergyTankTransform,
    EpisodeMetricsTransform,
    ImpedanceTransform,
    JointTorqueTransform,
    MacroStepTransform,
    ProMPTransform,
    ViaPointTransform,
)


@dataclass(frozen=True)
class Config(EpisodeLevelConfig):
    """Train PPT (ProMP + PPO + energy tank) on box pushing.

    Attributes:
        e_max: capacity of the tank [J]; None takes that of the goal: 1.3 J for a pose, 3 J for a position.
        energy_penalty: reward subtracted for energy from the tank, in training [1/J]; None takes that of the goal: 0.5
            for a pose, 0 for a position.
        tank_mode: law of the tanks: paper, passive, parallel, rate or impact.
    """

    run_dir: Path = Path("runs/ppt_push")
    e_max: ByGoal = None  # type: ignore[assignment]
    energy_penalty: ByGoal = None  # type: ignore[assignment]
    tank_mode: str = "paper"

    bounds: ClassVar[dict[str, Bounds]] = {"energy_penalty": Bounds(0.0, 1e6, "1/J")}


def make_modules(config: Config) -> dict[str, ProMP]:
    """The movement primitive, its prior not fitted yet: what a checkpoint holds besides the networks."""
    return {"promp": ProMP(config.num_basis, len(PUSH_AXES), config.duration)}


def make_chain(config: Config, base: PushEnv, promp: ProMP) -> list[Transform]:
    """PPT's chain: what stands above the macro step runs at control rate."""
    mode, damping = config.tank_mode, damping_key(config.tank_mode)
    return [
        motor_tank(config.p_max, config.e_max, mode, base.arm),
        JointTorqueTransform(Kinematics(base.arm, base.tool_length), damping_key=damping),
        EnergyTankTransform(config.p_max, config.e_max, flow_key="twist", **wrench_law(mode, base.arm)),
        EnergyPenaltyTransform(config.energy_penalty),
        ImpedanceTransform(make_controller(config), damping_key=damping),
        EpisodeMetricsTransform(episode_metrics(config)),
        MacroStepTransform(config.chunk, discount=config.ppo.gamma),
        ProMPTransform(
            promp,
            TaskSpace(PUSH_AXES, base.start_pose),
            residual_scale=config.residual_scale,
            replan_steps=config.chunk,
        ),
        ViaPointTransform(promp),
    ]


def make_policy(config: Config, env: TransformedEnv) -> tuple[nn.Module, nn.Module]:
    """Actor and critic."""
    return make_push_policy(config, env, initial_scale=config.initial_scale, extra_keys=("tank_energy", "valve"))


def fit(config: Config, promp: ProMP) -> None:
    """Fit the prior to scripted demonstrations."""
    fit_push_prior(promp, goal=config.goal, counter_turn=config.counter_turn)


RECIPE = Recipe(
    "ppt_push", "PPT", PUSH, Config, make_chain, make_policy, make_modules, fit, has_tank=True, has_reference=True
)

if __name__ == "__main__":
    RECIPE.main()
