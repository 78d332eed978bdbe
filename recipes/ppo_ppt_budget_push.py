"""PPT on box pushing with an energy budget that the policy asks for, once an episode, and pays for.

Train with defaults, or look at the options: ``python recipes/ppo_ppt_budget_push.py --help``.
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
    EnergyBudgetTransform,
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
    """Train PPT on box pushing with a budget of energy that it asks for at the start of each episode.

    Attributes:
        e_max: most energy that an episode is granted [J]; None takes the capacity of PPT's tank: 1.3 J for a pose, 3 J
            for a position.
        budget_weight: reward subtracted for each joule that an episode is granted [1/J].
        initial_share: share of the range of budgets that the untrained policy asks for [-].
        tank_mode: law of the tanks: paper, passive, parallel, rate or impact.
    """

    run_dir: Path = Path("runs/ppt_budget_push")
    e_max: ByGoal = None  # type: ignore[assignment]
    budget_weight: float = 1.5
    initial_share: float = 0.8
    tank_mode: str = "paper"

    bounds: ClassVar[dict[str, Bounds]] = {
        "budget_weight": Bounds(0.0, 1e6, "1/J"),
        "initial_share": Bounds(0.001, 0.999),
    }


def make_modules(config: Config) -> dict[str, ProMP]:
    """The movement primitive, its prior not fitted yet: what a checkpoint holds besides the networks."""
    return {"promp": ProMP(config.num_basis, len(PUSH_AXES), config.duration)}


def make_chain(config: Config, base: PushEnv, promp: ProMP) -> list[Transform]:
    """PPT's chain with a budget: what stands above the macro step runs at control rate."""
    mode, damping = config.tank_mode, damping_key(config.tank_mode)
    law = wrench_law(mode, base.arm)
    return [
        motor_tank(config.p_max, config.e_max, mode, base.arm, e_max_key="e_max"),
        JointTorqueTransform(Kinematics(base.arm, base.tool_length), damping_key=damping),
        EnergyTankTransform(config.p_max, config.e_max, flow_key="twist", e_max_key="e_max", **law),
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
        EnergyBudgetTransform(config.e_max, weight=config.budget_weight, initial_share=config.initial_share),
    ]


def make_policy(config: Config, env: TransformedEnv) -> tuple[nn.Module, nn.Module]:
    """Actor and critic; the request for energy is the same when left and right change places."""
    keys = ("tank_energy", "valve", "energy_budget")
    return make_push_policy(config, env, initial_scale=config.initial_scale, extra_keys=keys, beside=(1,))


def fit(config: Config, promp: ProMP) -> None:
    """Fit the prior to scripted demonstrations."""
    fit_push_prior(promp, goal=config.goal, counter_turn=config.counter_turn)


RECIPE = Recipe(
    "ppt_budget_push", "PPT, budget", PUSH, Config, make_chain, make_policy, make_modules, fit,
    has_tank=True, has_reference=True, episode_keys=("energy_budget",), in_study=False,
)  # fmt: skip

if __name__ == "__main__":
    RECIPE.main()
