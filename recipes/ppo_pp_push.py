"""PP on box pushing: ProMP residual policy and Cartesian impedance; PPT without its energy tank.

Train with defaults, or look at the options: ``python recipes/ppo_pp_push.py --help``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from torch import nn
from torchrl.envs import Compose, TransformedEnv

from ppt_rl.modules import Kinematics, ProMP, TaskSpace
from ppt_rl.tasks import episode_metrics, make_controller, prepare_torch
from ppt_rl.tasks.push import PUSH_AXES, EpisodeLevelConfig, fit_push_prior, make_push_env, make_push_policy
from ppt_rl.training import run_recipe
from ppt_rl.transforms import (
    EpisodeMetricsTransform,
    ImpedanceTransform,
    JointTorqueTransform,
    MacroStepTransform,
    ProMPTransform,
    ViaPointTransform,
)

VARIANT = "pp_push"


@dataclass(frozen=True)
class Config(EpisodeLevelConfig):
    """Train PP (ProMP + PPO) on box pushing."""

    run_dir: Path = Path("runs/pp_push")


def make_modules(config: Config) -> dict[str, ProMP]:
    """What a checkpoint holds besides the networks: the movement primitive, its prior not fitted yet."""
    return {"promp": ProMP(config.num_basis, len(PUSH_AXES), config.duration)}


def make_env(
    config: Config, promp: ProMP, *, num_envs: int | None = None, seed: int | None = None, audit: bool = False
) -> TransformedEnv:
    """The pushing environment with PP's chain: what stands above the macro step runs at control rate."""
    base, dt = make_push_env(config, num_envs=num_envs, seed=seed, audit=audit), config.control_dt
    return TransformedEnv(
        base,
        Compose(
            JointTorqueTransform(Kinematics(base.arm, base.tool_length), dt=dt),
            ImpedanceTransform(make_controller(config)),
            EpisodeMetricsTransform(episode_metrics(config)),
            MacroStepTransform(config.chunk, discount=config.ppo.gamma),
            ProMPTransform(
                promp,
                TaskSpace(PUSH_AXES, base.start_pose),
                residual_scale=config.residual_scale,
                replan_steps=config.chunk,
                dt=dt,
            ),
            ViaPointTransform(promp),
        ),
    )


def make_policy(config: Config, env: TransformedEnv) -> tuple[nn.Module, nn.Module]:
    """Actor and critic."""
    return make_push_policy(env, initial_scale=config.initial_scale)


def main(config: Config) -> Path:
    """Train."""
    prepare_torch(config)
    modules = make_modules(config)
    fit_push_prior(modules["promp"])  # from scripted demonstrations
    env = make_env(config, modules["promp"])
    return run_recipe(VARIANT, config, env, *make_policy(config, env), policy_steps=config.policy_steps, extra=modules)


if __name__ == "__main__":
    from ppt_rl.training import run_cli

    run_cli(main, Config)
