"""ST on box pushing: a step-wise Cartesian velocity policy behind an energy tank.

Train with defaults, or look at the options: ``python recipes/ppo_st_push.py --help``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from torch import nn
from torchrl.envs import StepCounter, Transform, TransformedEnv, UnaryTransform

from ppt_rl.envs import PushEnv
from ppt_rl.evaluation import Recipe
from ppt_rl.modules import Kinematics, TaskSpace
from ppt_rl.tasks import episode_metrics, make_controller, motor_tank
from ppt_rl.tasks.push import PUSH, PUSH_AXES, ByGoal, StepWiseConfig, make_push_policy
from ppt_rl.transforms import (
    CartesianVelocityTransform,
    EnergyTankTransform,
    EpisodeMetricsTransform,
    HoldActionTransform,
    ImpedanceTransform,
    JointTorqueTransform,
    MacroStepTransform,
)


@dataclass(frozen=True)
class Config(StepWiseConfig):
    """Train ST (step-wise PPO + energy tank) on box pushing.

    Attributes:
        e_max: capacity of the tank [J]; None takes that of the goal: 1.25 J for a pose, 3 J for a position.
    """

    run_dir: Path = Path("runs/st_push")
    e_max: ByGoal = None  # type: ignore[assignment]


def make_chain(config: Config, base: PushEnv) -> list[Transform]:
    """ST's chain: the policy decides every few control steps, and everything else runs at control rate."""
    return [
        motor_tank(config.p_max, config.e_max),
        JointTorqueTransform(Kinematics(base.arm, base.tool_length)),
        EnergyTankTransform(config.p_max, config.e_max, flow_key="twist"),
        ImpedanceTransform(make_controller(config)),
        EpisodeMetricsTransform(episode_metrics(config)),
        CartesianVelocityTransform(
            TaskSpace(PUSH_AXES, base.start_pose), max_velocity=config.velocity, max_lead=config.lead
        ),
        MacroStepTransform(config.hold_steps, discount=config.ppo.gamma),
        HoldActionTransform(config.hold_steps, smoothing=config.smoothing),
        StepCounter(),
        UnaryTransform(["step_count"], ["phase"], fn=lambda count: count / config.batch_steps),
    ]


def make_policy(config: Config, env: TransformedEnv) -> tuple[nn.Module, nn.Module]:
    """Actor and critic."""
    return make_push_policy(
        config,
        env,
        initial_scale=config.initial_scale,
        extra_keys=("reference_position", "last_action", "tank_energy", "valve"),
    )


RECIPE = Recipe("st_push", "ST", PUSH, Config, make_chain, make_policy, has_tank=True)

if __name__ == "__main__":
    RECIPE.main()
