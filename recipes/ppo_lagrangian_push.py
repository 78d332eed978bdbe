"""Constrained PPO on box pushing: PP's policy under a limit on the work or the power of an episode, without a tank.

Train with defaults, or look at the options: ``python recipes/ppo_lagrangian_push.py --help``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Literal, get_args

from torch import nn
from torchrl.envs import Transform, TransformedEnv

from ppt_rl.envs import PushEnv
from ppt_rl.evaluation import Recipe
from ppt_rl.functional import PIDGains
from ppt_rl.functional.argument_checks import require_in_range, shown
from ppt_rl.functional.checks import Bounds
from ppt_rl.modules import Kinematics, PIDMultiplier, ProMP, TaskSpace
from ppt_rl.tasks import episode_metrics, make_controller
from ppt_rl.tasks.push import (
    PUSH,
    PUSH_AXES,
    ByGoal,
    EpisodeLevelConfig,
    fit_push_prior,
    make_push_cost_critic,
    make_push_policy,
)
from ppt_rl.training import Constraint
from ppt_rl.transforms import (
    EpisodeMetricsTransform,
    ImpedanceTransform,
    JointTorqueTransform,
    MacroStepTransform,
    PowerLimitTransform,
    ProMPTransform,
    ViaPointTransform,
)

Cost = Literal["work", "excess"]
#: Default limits [J per episode]. Without a limit a policy does 2.5 J, and one that may do 1.2 J learns to need less;
#: the limit of the work is lower still, so that it binds to the end of the training.
_LIMITS = {"work": 0.7, "excess": 0.1}


@dataclass(frozen=True)
class Config(EpisodeLevelConfig):
    """Train PP (ProMP + PPO) on box pushing, with the mean cost of an episode under a limit.

    Attributes:
        cost: what is limited: the commanded work of an episode, or the part of it that was done above p_max.
        cost_limit: limit of its mean [J per episode]; None takes 0.7 J for the work, which binds to the end of the
            training, and 0.1 J for the excess.
        pid: gains of the controller that moves the multiplier.
        initial_multiplier: multiplier to start from [1/J].
        cost_critic: whether the cost has a critic of its own; else the one critic learns the penalised reward.
    """

    run_dir: Path = Path("runs/lagrangian_push")
    cost: Cost = "work"
    cost_limit: ByGoal = None  # type: ignore[assignment]
    pid: PIDGains = field(default_factory=lambda: PIDGains(proportional=4.0, integral=0.15))
    initial_multiplier: float = 0.0
    cost_critic: bool = True

    bounds: ClassVar[dict[str, Bounds]] = {
        "cost_limit": Bounds(0.0, 1e6, "J per episode"),
        "initial_multiplier": Bounds(0.0, 1e9, "1/J"),
    }

    def __post_init__(self) -> None:
        """Take the limit of the cost, and refuse what cannot be kept or limits nothing."""
        if self.cost not in get_args(Cost):
            raise ValueError(f"cost is {shown(self.cost)}; expected one of {list(get_args(Cost))}.")
        if self.cost_limit is None:
            object.__setattr__(self, "cost_limit", _LIMITS[self.cost])
        super().__post_init__()
        require_in_range("initial_multiplier", self.initial_multiplier, 0.0, self.pid.max_multiplier, "[1/J]")
        if self.cost == "work" and self.cost_limit == 0.0:
            raise ValueError("cost_limit is 0 J; expected more, since a box is not moved without work. Raise it.")
        if not any((self.pid.proportional, self.pid.integral, self.pid.derivative, self.initial_multiplier)):
            raise ValueError(
                "the gains of pid and initial_multiplier are all 0, so nothing limits the cost; raise one of them, or "
                "train pp_push."
            )

    def implied(self, changes: Mapping[str, Any]) -> dict[str, Any]:
        """Where the cost changes, a limit that has its default takes that of the new cost."""
        changed = changes.get("cost", self.cost) != self.cost and self.cost_limit == _LIMITS[self.cost]
        return super().implied(changes) | ({"cost_limit": None} if changed else {})


def make_modules(config: Config) -> dict[str, ProMP]:
    """The movement primitive, its prior not fitted yet: what a checkpoint holds besides the networks."""
    return {"promp": ProMP(config.num_basis, len(PUSH_AXES), config.duration)}


def make_cost(config: Config) -> PowerLimitTransform:
    """The cost of a control step: its commanded work, or the part of it above the limit of power."""
    return PowerLimitTransform(0.0 if config.cost == "work" else config.p_max, power_key="power")


def make_chain(config: Config, base: PushEnv, promp: ProMP) -> list[Transform]:
    """PP's chain with a cost: what stands above the macro step runs at control rate."""
    return [
        JointTorqueTransform(Kinematics(base.arm, base.tool_length)),
        ImpedanceTransform(make_controller(config)),
        make_cost(config),
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


def make_constraint(config: Config, env: TransformedEnv) -> Constraint:
    """The limit on the mean cost of an episode."""
    multiplier = PIDMultiplier(config.cost_limit, config.pid, initial=config.initial_multiplier)
    return Constraint(multiplier, make_push_cost_critic(config, env) if config.cost_critic else None)


def fit(config: Config, promp: ProMP) -> None:
    """Fit the prior to scripted demonstrations."""
    fit_push_prior(promp, goal=config.goal, counter_turn=config.counter_turn)


RECIPE = Recipe(
    "lagrangian_push", "PP constrained", PUSH, Config, make_chain, make_policy, make_modules, fit, has_reference=True,
    make_constraint=make_constraint, in_study=False,
)  # fmt: skip

if __name__ == "__main__":
    RECIPE.main()
