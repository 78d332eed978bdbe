"""ST on box pushing: a step-wise Cartesian velocity policy behind an energy tank.

Train with defaults, or look at the options: ``python recipes/ppo_st_push.py --help``.
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
from ppt_rl.modules import Kinematics, ProMP
from ppt_rl.tasks import damping_key, episode_metrics, make_controller, motor_tank, wrench_law
from ppt_rl.tasks.push import (
    PUSH,
    ByGoal,
    StepWiseConfig,
    fit_step_wise,
    make_push_policy,
    step_wise_modules,
    step_wise_transforms,
)
from ppt_rl.transforms import (
    EnergyPenaltyTransform,
    EnergyTankTransform,
    EpisodeMetricsTransform,
    ImpedanceTransform,
    JointTorqueTransform,
)


@dataclass(frozen=True)
class Config(StepWiseConfig):
    """Train ST (step-wise PPO + energy tank) on box pushing.

    Attributes:
        e_max: capacity of the tank [J]; None takes that of the goal: 1.3 J for a pose, 3 J for a position.
        energy_penalty: reward subtracted for energy from the tank, in training [1/J]; None takes that of the goal: 0.5
            for a pose, 0 for a position.
        tank_mode: law of the tanks: paper, passive, parallel, rate or impact.
    """

    run_dir: Path = Path("runs/st_push")
    e_max: ByGoal = None  # type: ignore[assignment]
    energy_penalty: ByGoal = None  # type: ignore[assignment]
    tank_mode: str = "paper"

    bounds: ClassVar[dict[str, Bounds]] = {"energy_penalty": Bounds(0.0, 1e6, "1/J")}


def make_chain(config: Config, base: PushEnv, promp: ProMP | None = None) -> list[Transform]:
    """ST's chain: the policy decides every few control steps, and everything else runs at control rate."""
    mode, damping = config.tank_mode, damping_key(config.tank_mode)
    return [
        motor_tank(config.p_max, config.e_max, mode, base.arm),
        JointTorqueTransform(Kinematics(base.arm, base.tool_length), damping_key=damping),
        EnergyTankTransform(config.p_max, config.e_max, flow_key="twist", **wrench_law(mode, base.arm)),
        EnergyPenaltyTransform(config.energy_penalty),
        ImpedanceTransform(make_controller(config), damping_key=damping),
        EpisodeMetricsTransform(episode_metrics(config)),
        *step_wise_transforms(config, base, promp),
    ]


def make_policy(config: Config, env: TransformedEnv) -> tuple[nn.Module, nn.Module]:
    """Actor and critic."""
    return make_push_policy(
        config,
        env,
        initial_scale=config.initial_scale,
        extra_keys=("reference_position", "last_action", "tank_energy", "valve"),
    )


RECIPE = Recipe("st_push", "ST", PUSH, Config, make_chain, make_policy, step_wise_modules, fit_step_wise, has_tank=True)

if __name__ == "__main__":
    RECIPE.main()
