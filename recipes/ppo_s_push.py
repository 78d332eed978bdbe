"""S on box pushing: a step-wise Cartesian velocity policy; ST without its energy tank.

Train with defaults, or look at the options: ``python recipes/ppo_s_push.py --help``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from torch import nn
from torchrl.envs import Compose, StepCounter, TransformedEnv, UnaryTransform

from ppt_rl.modules import Kinematics, TaskSpace
from ppt_rl.tasks import episode_metrics, make_controller, prepare_torch
from ppt_rl.tasks.push import PUSH_AXES, StepWiseConfig, make_push_env, make_push_policy
from ppt_rl.training import run_recipe
from ppt_rl.transforms import (
    CartesianVelocityTransform,
    EpisodeMetricsTransform,
    ImpedanceTransform,
    JointTorqueTransform,
)

VARIANT = "s_push"


@dataclass(frozen=True)
class Config(StepWiseConfig):
    """Train S (step-wise PPO) on box pushing."""

    run_dir: Path = Path("runs/s_push")


def make_modules(config: Config) -> dict[str, nn.Module]:
    """What a checkpoint holds besides the networks: nothing."""
    return {}


def make_env(
    config: Config, *, num_envs: int | None = None, seed: int | None = None, audit: bool = False
) -> TransformedEnv:
    """The pushing environment with S's chain: everything runs at control rate."""
    base, dt = make_push_env(config, num_envs=num_envs, seed=seed, audit=audit), config.control_dt
    return TransformedEnv(
        base,
        Compose(
            JointTorqueTransform(Kinematics(base.arm, base.tool_length), dt=dt),
            ImpedanceTransform(make_controller(config)),
            EpisodeMetricsTransform(episode_metrics(config)),
            CartesianVelocityTransform(
                TaskSpace(PUSH_AXES, base.start_pose), max_velocity=config.velocity, max_lead=config.lead, dt=dt
            ),
            StepCounter(),
            UnaryTransform(["step_count"], ["phase"], fn=lambda count: count / base.horizon),
        ),
    )


def make_policy(config: Config, env: TransformedEnv) -> tuple[nn.Module, nn.Module]:
    """Actor and critic."""
    return make_push_policy(env, initial_scale=config.initial_scale, extra_keys=("reference_position",))


def main(config: Config) -> Path:
    """Train."""
    prepare_torch(config)
    env = make_env(config)
    return run_recipe(VARIANT, config, env, *make_policy(config, env), policy_steps=config.rollout_steps)


if __name__ == "__main__":
    from ppt_rl.training import run_cli

    run_cli(main, Config)
