"""PP on box pushing: ProMP residual policy and Cartesian impedance; PPT without its energy tank.

Train with defaults, or look at the options: ``python recipes/ppo_pp_push.py --help``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from torch import nn
from torchrl.envs import Transform, TransformedEnv

from ppt_rl.envs import PushEnv
from ppt_rl.evaluation import Recipe
from ppt_rl.modules import Kinematics, ProMP, TaskSpace
from ppt_rl.tasks import episode_metrics, make_controller
from ppt_rl.tasks.push import PUSH, PUSH_AXES, EpisodeLevelConfig, fit_push_prior, make_push_policy
from ppt_rl.transforms import (
    EpisodeMetricsTransform,
    ImpedanceTransform,
    JointTorqueTransform,
    MacroStepTransform,
    ProMPTransform,
    ViaPointTransform,
)


@dataclass(frozen=True)
class Config(EpisodeLevelConfig):
    """Train PP (ProMP + PPO) on box pushing."""

    run_dir: Path = Path("runs/pp_push")


def make_modules(config: Config) -> dict[str, ProMP]:
    """The movement primitive, its prior not fitted yet: what a checkpoint holds besides the networks."""
    return {"promp": ProMP(config.num_basis, len(PUSH_AXES), config.duration)}


def make_chain(config: Config, base: PushEnv, promp: ProMP) -> list[Transform]:
    """PP's chain: what stands above the macro step runs at control rate."""
    return [
        JointTorqueTransform(Kinematics(base.arm, base.tool_length)),
        ImpedanceTransform(make_controller(config)),
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
    return make_push_policy(config, env, initial_scale=config.initial_scale)


def fit(config: Config, promp: ProMP) -> None:
    """Fit the prior to scripted demonstrations."""
    fit_push_prior(promp, goal=config.goal, counter_turn=config.counter_turn)


RECIPE = Recipe("pp_push", "PP", PUSH, Config, make_chain, make_policy, make_modules, fit, has_reference=True)

if __name__ == "__main__":
    RECIPE.main()
