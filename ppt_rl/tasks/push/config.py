"""What the four pushing recipes have in common: options, environment, controller, networks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from torch import nn
from torchrl.envs import TransformedEnv

from ppt_rl.envs.push import PushEnv
from ppt_rl.tasks.config import TaskConfig, make_engine_config
from ppt_rl.training.recipe import make_actor_critic

__all__ = [
    "PRIVILEGED",
    "EpisodeLevelConfig",
    "PushConfig",
    "StepWiseConfig",
    "make_push_env",
    "make_push_policy",
]

#: What a policy may know, in training and at test time; the critic, needed in training only, sees the box as well.
_KNOWN = ("box_start", "goal", "box_size", "pose", "twist", "wrench", "phase")
#: Observations that exist in simulation only; no evaluated policy sees them.
PRIVILEGED = ("box_pose",)


@dataclass(frozen=True)
class PushConfig(TaskConfig):
    """Options of every pushing recipe.

    Attributes:
        box_sizes: edges of the boxes to draw from [m]: 0.06 (50 g), 0.08 (80 g).
    """

    run_dir: Path = Path("runs/push")
    box_sizes: tuple[float, ...] = (0.06, 0.08)


@dataclass(frozen=True)
class EpisodeLevelConfig(PushConfig):
    """Options of the recipes whose policy acts on ProMP weights.

    Attributes:
        num_basis: basis functions of the ProMP for each of x, y and yaw.
        replan_steps: control steps between policy steps; 0 is one policy step per episode.
        residual_position: how far a residual of 1 moves a weight in x and y [m].
        residual_yaw: how far a residual of 1 moves a weight in yaw [rad].
        initial_scale: standard deviation of the untrained policy, in residuals [-].
    """

    num_basis: int = 8
    replan_steps: int = 0
    residual_position: float = 0.03
    residual_yaw: float = 0.3
    initial_scale: float = 0.25

    @property
    def chunk(self) -> int:
        """Control steps of a policy step."""
        return self.replan_steps or self.horizon

    @property
    def policy_steps(self) -> int:
        """Policy steps of an episode, which are those of a batch."""
        return -(-self.horizon // self.chunk)

    @property
    def residual_scale(self) -> tuple[float, float, float]:
        """How far a residual of 1 moves a weight in x, y [m] and yaw [rad]."""
        return self.residual_position, self.residual_position, self.residual_yaw


@dataclass(frozen=True)
class StepWiseConfig(PushConfig):
    """Options of the recipes whose policy acts on Cartesian velocity.

    Attributes:
        max_velocity: velocity of an action of 1 in x and y [m/s].
        max_yaw_rate: yaw rate of an action of 1 [rad/s].
        max_lead: farthest the reference may be ahead of the tool in x and y [m].
        max_yaw_lead: farthest it may be ahead in yaw [rad].
        initial_scale: standard deviation of the untrained policy, in actions [-].
        rollout_steps: control steps of every environment between two updates.
    """

    max_velocity: float = 0.4
    max_yaw_rate: float = 1.5
    max_lead: float = 0.05
    max_yaw_lead: float = 0.3
    initial_scale: float = 0.25
    rollout_steps: int = 60

    @property
    def velocity(self) -> tuple[float, float, float]:
        """Velocity of an action of 1 in x, y [m/s] and yaw [rad/s]."""
        return self.max_velocity, self.max_velocity, self.max_yaw_rate

    @property
    def lead(self) -> tuple[float, float, float]:
        """Farthest the reference may be ahead in x, y [m] and yaw [rad]."""
        return self.max_lead, self.max_lead, self.max_yaw_lead


def make_push_env(
    config: PushConfig, *, num_envs: int | None = None, seed: int | None = None, audit: bool = False
) -> PushEnv:
    """The bare environment of a pushing recipe.

    Args:
        config: the recipe's options.
        num_envs: instead of the configured number.
        seed: instead of the configured one.
        audit: whether power and work are measured at the physics' rate too.

    Returns:
        The environment.
    """
    return PushEnv(
        num_envs=num_envs or config.num_envs,
        box_sizes=config.box_sizes,
        duration=config.duration,
        control_dt=config.control_dt,
        seed=config.seed if seed is None else seed,
        engine=make_engine_config(config, audit=audit),
    )


def make_push_policy(
    env: TransformedEnv, *, initial_scale: float, extra_keys: Sequence[str] = ()
) -> tuple[nn.Module, nn.Module]:
    """Actor on what is known at test time, critic on the box's pose as well.

    Args:
        env: with the recipe's chain.
        initial_scale: standard deviation of the untrained policy [action units].
        extra_keys: observations that the recipe's transforms add.

    Returns:
        Actor and critic.
    """
    keys = [*_KNOWN, *extra_keys]
    return make_actor_critic(env, keys, [*keys, *PRIVILEGED], initial_scale=initial_scale)
