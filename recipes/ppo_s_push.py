"""S on box pushing: a step-wise Cartesian velocity policy; ST without its energy tank.

Train with defaults, or look at the options: ``python recipes/ppo_s_push.py --help``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from torch import nn
from torchrl.envs import Transform, TransformedEnv

from ppt_rl.envs import PushEnv
from ppt_rl.evaluation import Recipe
from ppt_rl.modules import Kinematics, ProMP
from ppt_rl.tasks import episode_metrics, make_controller
from ppt_rl.tasks.push import (
    PUSH,
    StepWiseConfig,
    fit_step_wise,
    make_push_policy,
    step_wise_modules,
    step_wise_transforms,
)
from ppt_rl.transforms import (
    EpisodeMetricsTransform,
    ImpedanceTransform,
    JointTorqueTransform,
)


@dataclass(frozen=True)
class Config(StepWiseConfig):
    """Train S (step-wise PPO) on box pushing."""

    run_dir: Path = Path("runs/s_push")


def make_chain(config: Config, base: PushEnv, promp: ProMP | None = None) -> list[Transform]:
    """S's chain: the policy decides every few control steps, and everything else runs at control rate."""
    return [
        JointTorqueTransform(Kinematics(base.arm, base.tool_length)),
        ImpedanceTransform(make_controller(config)),
        EpisodeMetricsTransform(episode_metrics(config)),
        *step_wise_transforms(config, base, promp),
    ]


def make_policy(config: Config, env: TransformedEnv) -> tuple[nn.Module, nn.Module]:
    """Actor and critic."""
    return make_push_policy(
        config,
        env,
        initial_scale=config.initial_scale,
        extra_keys=("reference_position", "last_action"),
    )


RECIPE = Recipe("s_push", "S", PUSH, Config, make_chain, make_policy, step_wise_modules, fit_step_wise)

if __name__ == "__main__":
    RECIPE.main()
