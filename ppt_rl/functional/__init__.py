"""The library's control laws and metrics as pure functions of tensors."""

from ppt_rl.functional.contact import WallTouch
from ppt_rl.functional.contact_via_point import ViaPointConfig
from ppt_rl.functional.energy_tank import TANK_LAWS, EnergyTankStep, TankLaw, energy_tank
from ppt_rl.functional.impedance import (
    braking_part,
    cartesian_impedance,
    critical_damping,
    joint_torque,
    nullspace_torque,
    orientation_error,
    power,
)
from ppt_rl.functional.metrics import MetricsConfig, begin_metrics, summarise_metrics, update_metrics
from ppt_rl.functional.tank_laws import parallel_tank, passive_tank, rate_tank

__all__ = [
    "TANK_LAWS",
    "EnergyTankStep",
    "MetricsConfig",
    "TankLaw",
    "ViaPointConfig",
    "WallTouch",
    "begin_metrics",
    "braking_part",
    "cartesian_impedance",
    "critical_damping",
    "energy_tank",
    "joint_torque",
    "nullspace_torque",
    "orientation_error",
    "parallel_tank",
    "passive_tank",
    "power",
    "rate_tank",
    "summarise_metrics",
    "update_metrics",
]
