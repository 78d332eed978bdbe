"""What the recipes of every task have in common: options, controller, metrics, torch's settings."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import torch

from ppt_rl.arms import PANDA, Arm
from ppt_rl.envs.physics import EngineConfig
from ppt_rl.functional.metrics import MetricsConfig
from ppt_rl.modules.impedance import CartesianImpedanceController
from ppt_rl.training.ppo import PPOConfig

__all__ = ["TaskConfig", "episode_metrics", "make_controller", "make_engine_config", "prepare_torch"]


@dataclass(frozen=True)
class TaskConfig:
    """Options of every recipe.

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
        stiffness: linear stiffness of the impedance [N/m].
        damping_ratio: of the impedance [-].
        p_max: power limit [W]: of the tank where there is one, and of the overload metric.
        ppo: settings of PPO.
    """

    run_dir: Path = Path("runs/run")
    seed: int = 0
    resume: bool = False
    num_envs: int = 128
    num_threads: int = 0
    torch_threads: int = 1
    duration: float = 3.0
    physics_dt: float = 0.0005
    control_dt: float = 0.01
    stiffness: float = 400.0
    damping_ratio: float = 1.0
    p_max: float = 2.0
    ppo: PPOConfig = field(default_factory=PPOConfig)

    @property
    def horizon(self) -> int:
        """Control steps of an episode."""
        return max(1, round(self.duration / self.control_dt))


def make_controller(config: TaskConfig, arm: Arm = PANDA) -> CartesianImpedanceController:
    """The impedance controller of a recipe.

    Args:
        config: the recipe's options.
        arm: the arm, from whose apparent inertia the damping follows.

    Returns:
        The controller.
    """
    linear = (config.stiffness,) * 3
    return CartesianImpedanceController((*linear, 30.0, 30.0, 30.0), config.damping_ratio, inertia=arm.apparent_inertia)


def make_engine_config(config: TaskConfig, *, audit: bool = False) -> EngineConfig:
    """Options of the physics of a recipe's environment.

    Args:
        config: the recipe's options.
        audit: whether power and work are measured at the rate of the physics too.

    Returns:
        The options.
    """
    return EngineConfig(config.physics_dt, config.num_threads or None, audit)


def episode_metrics(config: TaskConfig) -> MetricsConfig:
    """Constants of the metrics of a recipe.

    Args:
        config: the recipe's options.

    Returns:
        The constants.
    """
    return MetricsConfig(dt=config.control_dt, p_max=config.p_max)


def prepare_torch(config: TaskConfig) -> None:
    """Seed torch and set its threads.

    Args:
        config: the recipe's options.
    """
    torch.set_num_threads(config.torch_threads)
    torch.manual_seed(config.seed)
