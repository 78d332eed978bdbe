"""What the four pushing recipes have in common: options, environment, controller, networks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import torch
from torch import nn
from torchrl.envs import TransformedEnv

from ppt_rl.envs.push import PandaPushEnv
from ppt_rl.functional.metrics import MetricsConfig
from ppt_rl.modules.impedance import CartesianImpedanceController
from ppt_rl.training.ppo import PPOConfig
from ppt_rl.training.recipe import make_actor_critic

__all__ = [
    "PRIVILEGED",
    "EpisodeLevelConfig",
    "PushConfig",
    "StepWiseConfig",
    "make_push_controller",
    "make_push_env",
    "make_push_policy",
    "prepare_torch",
    "push_metrics",
]

#: What a policy may know, in training and at test time; the critic, needed in training only, sees the box as well.
_KNOWN = ("box_start", "goal", "box_size", "pose", "twist", "wrench", "phase")
#: Observations that exist in simulation only; no evaluated policy sees them.
PRIVILEGED = ("box_pose",)


@dataclass(frozen=True)
class PushConfig:
    """Options of every pushing recipe.

    Attributes:
        run_dir: where logs, checkpoints and figures go.
        seed: of everything random.
        resume: go on from the newest checkpoint in run_dir.
        num_envs: environments that step together.
        num_threads: physics threads; 0 takes one per CPU.
        torch_threads: threads of torch while it simulates; its tensors are small there, more than one gains nothing.
        duration: episode length [s].
        physics_dt: time step of the physics [s].
        control_dt: time step of the controller [s].
        box_sizes: edges of the boxes to draw from [m]: 0.06 (50 g), 0.08 (80 g).
        stiffness: linear stiffness of the impedance [N/m].
        damping_ratio: of the impedance [-].
        p_max: power limit [W]: of the tank where there is one, and of the overload metric.
        ppo: settings of PPO.
    """

    run_dir: Path = Path("runs/push")
    seed: int = 0
    resume: bool = False
    num_envs: int = 128
    num_threads: int = 0
    torch_threads: int = 1
    duration: float = 3.0
    physics_dt: float = 0.0005
    control_dt: float = 0.01
    box_sizes: tuple[float, ...] = (0.06, 0.08)
    stiffness: float = 400.0
    damping_ratio: float = 1.0
    p_max: float = 2.0
    ppo: PPOConfig = field(default_factory=PPOConfig)

    @property
    def horizon(self) -> int:
        """Control steps of an episode."""
        return max(1, round(self.duration / self.control_dt))


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
) -> PandaPushEnv:
    """The bare environment of a pushing recipe.

    Args:
        config: the recipe's options.
        num_envs: instead of the configured number.
        seed: instead of the configured one.
        audit: whether power and work are measured at the physics' rate too.

    Returns:
        The environment.
    """
    return PandaPushEnv(
        num_envs=num_envs or config.num_envs,
        box_sizes=config.box_sizes,
        duration=config.duration,
        physics_dt=config.physics_dt,
        control_dt=config.control_dt,
        num_threads=config.num_threads or None,
        seed=config.seed if seed is None else seed,
        audit=audit,
    )


def make_push_controller(config: PushConfig) -> CartesianImpedanceController:
    """The impedance controller of a pushing recipe.

    Args:
        config: the recipe's options.

    Returns:
        The controller.
    """
    linear = (config.stiffness,) * 3
    return CartesianImpedanceController((*linear, 30.0, 30.0, 30.0), config.damping_ratio)


def push_metrics(config: PushConfig) -> MetricsConfig:
    """Constants of the metrics of a pushing recipe.

    Args:
        config: the recipe's options.

    Returns:
        The constants.
    """
    return MetricsConfig(dt=config.control_dt, p_max=config.p_max)


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


def prepare_torch(config: PushConfig) -> None:
    """Seed torch and set its threads.

    Args:
        config: the recipe's options.
    """
    torch.set_num_threads(config.torch_threads)
    torch.manual_seed(config.seed)
