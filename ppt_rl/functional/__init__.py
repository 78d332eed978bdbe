"""The library's control laws and metrics as pure functions of tensors."""

from ppt_rl.functional.contact import WallTouch
from ppt_rl.functional.contact_via_point import ViaPointConfig
from ppt_rl.functional.energy_tank import TANK_LAWS, EnergyTankStep, TankLaw, energy_tank
from ppt_rl.functional.impedance import (
    cartesian_impedance,
    critical_damping,
    joint_torque,
    nullspace_torque,
    orientation_error,
    power,
)
from ppt_rl.functional.lagrangian import MultiplierState, PIDGains, begin_multiplier, penalised, pid_multiplier
from ppt_rl.functional.metrics import MetricsConfig, begin_metrics, summarise_metrics, update_metrics

__all__ = [
    "TANK_LAWS",
    "EnergyTankStep",
    "MetricsConfig",
    "MultiplierState",
    "PIDGains",
    "TankLaw",
    "ViaPointConfig",
    "WallTouch",
    "begin_metrics",
    "begin_multiplier",
    "cartesian_impedance",
    "critical_damping",
    "energy_tank",
    "joint_torque",
    "nullspace_torque",
    "orientation_error",
    "penalised",
    "pid_multiplier",
    "power",
    "summarise_metrics",
    "update_metrics",
]
