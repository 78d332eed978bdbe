"""PPT on box pushing with the layers that we recommend against collisions: a governed reference, a tank for impacts.

Train with defaults, or look at the options: ``python recipes/ppo_ppt_safe_push.py --help``.
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
    ReferenceGovernorTransform,
    ViaPointTransform,
)


@dataclass(frozen=True)
class Config(EpisodeLevelConfig):
    """Train PPT on box pushing behind a governor of the reference and a tank at the motors that withstands impacts.

    Attributes:
        e_max: capacity of the tank [J]; None takes that of the goal: 1.3 J for a pose, 3 J for a position.
        energy_penalty: reward subtracted for energy from the tank, in training [1/J]; None takes that of the goal: 0.5
            for a pose, 0 for a position.
        tank_mode: law of the tank of the wrench: paper, passive, parallel or rate.
        motor_mode: law of the tank at the motors: one of those, or impact.
        motor_margin: power limit of the tank at the motors, as a multiple of ``p_max``: it holds at every moment of a
            control step, through contact as well, where that of the wrench holds at its beginning.
        f_max: largest force with which the impedance pushes a tool that is held still [N].
        catch_up_speed: speed at which the governed reference catches up once the tool comes free [m/s].
    """

    run_dir: Path = Path("runs/ppt_safe_push")
    e_max: ByGoal = None  # type: ignore[assignment]
    energy_penalty: ByGoal = None  # type: ignore[assignment]
    tank_mode: str = "rate"
    motor_mode: str = "impact"
    motor_margin: float = 1.25
    f_max: float = 10.0
    catch_up_speed: float = 0.5

    bounds: ClassVar[dict[str, Bounds]] = {
        "energy_penalty": Bounds(0.0, 1e6, "1/J"),
        "motor_margin": Bounds(1e-3, 1e3),
        "f_max": Bounds(1e-3, 1e6, "N"),
        "catch_up_speed": Bounds(1e-6, 100.0, "m/s"),
    }


def make_modules(config: Config) -> dict[str, ProMP]:
    """The movement primitive, its prior not fitted yet: what a checkpoint holds besides the networks."""
    return {"promp": ProMP(config.num_basis, len(PUSH_AXES), config.duration)}


def make_chain(config: Config, base: PushEnv, promp: ProMP) -> list[Transform]:
    """PPT's chain with a governor: what stands above the macro step runs at control rate."""
    mode, damping = config.tank_mode, damping_key(config.tank_mode)
    return [
        motor_tank(config.motor_margin * config.p_max, config.e_max, config.motor_mode, base.arm),
        JointTorqueTransform(Kinematics(base.arm, base.tool_length), damping_key=damping),
        EnergyTankTransform(config.p_max, config.e_max, flow_key="twist", **wrench_law(mode, base.arm)),
        EnergyPenaltyTransform(config.energy_penalty),
        ImpedanceTransform(make_controller(config), damping_key=damping),
        ReferenceGovernorTransform(config.f_max, catch_up_speed=config.catch_up_speed, with_motion=True),
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
    "ppt_safe_push", "PPT, governed", PUSH, Config, make_chain, make_policy, make_modules, fit,
    has_tank=True, has_reference=True, in_study=False,
)  # fmt: skip

if __name__ == "__main__":
    RECIPE.main()
