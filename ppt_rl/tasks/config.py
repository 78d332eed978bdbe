"""What the recipes of every task have in common: options of the arm's control, controller and metrics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from ppt_rl.arms import Arm, find_arm
from ppt_rl.envs import EngineConfig
from ppt_rl.functional.checks import Bounds, require_at_most
from ppt_rl.functional.energy_tank import TANK_LAWS, law_reads
from ppt_rl.functional.metrics import MetricsConfig
from ppt_rl.modules.impedance import CartesianImpedanceController
from ppt_rl.modules.kinematics import Kinematics
from ppt_rl.training import RunConfig
from ppt_rl.transforms import EnergyTankTransform

__all__ = [
    "TaskConfig",
    "damping_key",
    "env_settings",
    "episode_metrics",
    "make_controller",
    "motor_tank",
    "tank_law",
    "wrench_law",
]

#: Largest numbers of physics steps in a control step, of control steps in an episode, and in those of all environments.
_MAX_SUBSTEPS, _MAX_STEPS, _MAX_TOTAL = 1000, 60_000, 20_000_000
#: Law of the tank that meters the wrench, where it is another one than at the motors.
_WRENCH_LAWS = {"impact": "rate"}
#: Laws that bound net energy, which the motors' tank settles by what the torque has delivered.
_NET_LAWS = ("passive", "parallel")


@dataclass(frozen=True)
class TaskConfig(RunConfig):
    """Options of every recipe.

    Attributes:
        arm: name of the arm.
        duration: episode length [s].
        physics_dt: time step of the physics [s].
        control_dt: time step of the controller [s].
        stiffness: linear stiffness of the impedance [N/m].
        damping_ratio: damping ratio of the impedance [-].
        p_max: power limit [W]: of the tank where there is one, and of the overload metric.
    """

    arm: str = "panda"
    duration: float = 3.0
    physics_dt: float = 0.0005
    control_dt: float = 0.01
    stiffness: float = 400.0
    damping_ratio: float = 1.0
    p_max: float = 2.0

    bounds: ClassVar[dict[str, Bounds]] = {
        "duration": Bounds(1e-3, 600.0, "s"),
        "physics_dt": Bounds(1e-5, 0.1, "s"),
        "control_dt": Bounds(1e-4, 1.0, "s"),
        "stiffness": Bounds(0.0, 1e6, "N/m"),
        "damping_ratio": Bounds(0.0, 100.0),
        "p_max": Bounds(1e-6, 1e6, "W"),
        "e_max": Bounds(1e-6, 1e6, "J"),  # of the recipes with a tank
        "num_basis": Bounds(2, 100),  # of the recipes with a ProMP
        "replan_steps": Bounds(0, _MAX_STEPS, "control steps"),
    }

    def __post_init__(self) -> None:
        """Refuse numbers out of bounds, and episodes that no machine could hold."""
        super().__post_init__()
        substeps = self.control_dt / self.physics_dt
        require_at_most("control_dt / physics_dt", substeps, _MAX_SUBSTEPS, "raise physics_dt or lower control_dt")
        require_at_most("duration / control_dt", self.horizon, _MAX_STEPS, "lower duration or raise control_dt")
        mode = getattr(self, "tank_mode", "paper")  # of the recipes with a tank
        if mode not in TANK_LAWS:
            raise ValueError(f"tank_mode is {mode!r}; expected one of {list(TANK_LAWS)}.")
        steps = self.num_envs * self.horizon
        require_at_most("num_envs * duration / control_dt", steps, _MAX_TOTAL, "lower num_envs or duration")

    @property
    def horizon(self) -> int:
        """Control steps of an episode."""
        return max(1, round(self.duration / self.control_dt))


def env_settings(config: TaskConfig, *, num_envs: int, seed: int | None, audit: bool) -> dict[str, Any]:
    """Arguments that the environments of every task take from a recipe's options.

    Args:
        config: options of the recipe.
        num_envs: number of environments that step together.
        seed: seed of the episodes; None draws one.
        audit: whether power and work are measured at the rate of the physics.

    Returns:
        Keyword arguments by name.
    """
    return {
        "num_envs": num_envs,
        "arm": find_arm(config.arm),
        "seed": seed,
        "control_dt": config.control_dt,
        "device": config.device,
        "engine": EngineConfig(config.physics_dt, config.num_threads or None, audit, config.engine),
    }


def make_controller(config: TaskConfig) -> CartesianImpedanceController:
    """The impedance controller of a recipe.

    Args:
        config: options of the recipe.

    Returns:
        The controller.
    """
    stiffness = (*(config.stiffness,) * 3, 30.0, 30.0, 30.0)
    inertia = find_arm(config.arm).apparent_inertia
    return CartesianImpedanceController(stiffness, config.damping_ratio, inertia=inertia)


def episode_metrics(config: TaskConfig) -> MetricsConfig:
    """Constants of the metrics of a recipe.

    Args:
        config: options of the recipe.

    Returns:
        The constants.
    """
    return MetricsConfig(p_max=config.p_max)


def motor_tank(
    p_max: float, e_max: float, mode: str = "paper", arm: Arm | None = None, *, e_max_key: str | None = None
) -> EnergyTankTransform:
    """The tank that stands first in a chain and bounds the torque that the motors execute, posture torque included.

    Its keys are ``motor_tank_energy`` and ``motor_valve``, so that a chain may also have the paper's tank, which bounds
    the wrench of the task and which the policy observes. With the laws of net energy, ``"passive"`` and ``"parallel"``,
    the level is settled after each step by what the torque has delivered.

    Args:
        p_max: power limit [W].
        e_max: capacity, and level at the start of an episode [J].
        mode: name of its law.
        arm: the arm, whose inertia some laws read; None for a law that does not.
        e_max_key: where the capacity of an episode is found, at most ``e_max``; None takes ``e_max`` always.

    Returns:
        The transform.
    """
    read = tank_law(mode, None if arm is None else Kinematics(arm, tool_length=0.0))
    keys = ("motor_tank_energy", "motor_valve")
    position_key = "joint_position" if mode in _NET_LAWS else None
    return EnergyTankTransform(
        p_max, e_max, flow_key="joint_velocity", out_keys=keys, e_max_key=e_max_key, position_key=position_key, **read
    )


def tank_law(mode: str, inertia: Sequence[float] | Kinematics | None) -> dict[str, Any]:
    """Arguments of an ``EnergyTankTransform`` that choose a law and give it what it reads.

    Args:
        mode: name of the law.
        inertia: what the tank's effort accelerates, as the transform takes it.

    Returns:
        Keyword arguments by name.
    """
    read: dict[str, Any] = {"mode": mode}
    law = TANK_LAWS.get(mode)
    if law is not None and "inertia" in law_reads(law):
        read["inertia"] = inertia
    return read if damping_key(mode) is None else read | {"damping_key": damping_key(mode)}


def wrench_law(mode: str, arm: Arm) -> dict[str, Any]:
    """The same for the paper's tank, which stands behind the one at the motors and meters the wrench of the task.

    Args:
        mode: name of the law of the tank at the motors.
        arm: the arm, whose apparent inertia some laws read.

    Returns:
        Keyword arguments by name. ``"impact"`` needs the inertia itself, which the arm as a whole has; a wrench is
        metered by ``"rate"`` then, to which a bound of the apparent inertia is enough.
    """
    return tank_law(_WRENCH_LAWS.get(mode, mode), arm.apparent_inertia)


def damping_key(mode: str) -> str | None:
    """Where the damping travels beside the action, for a law that reads it.

    Args:
        mode: name of the law.

    Returns:
        The key; None where nobody reads it.
    """
    law = TANK_LAWS.get(mode)
    return "damping" if law is not None and "damping" in law_reads(law) else None
