"""The library's control laws and metrics as pure functions of tensors."""

from ppt_rl.functional.energy_tank import EnergyTankStep, energy_tank
from ppt_rl.functional.impedance import (
    cartesian_impedance,
    critical_damping,
    joint_torque,
    nullspace_torque,
    orientation_error,
    power,
)
from ppt_rl.functional.metrics import MetricsConfig, begin_metrics, summarise_metrics, update_metrics

__all__ = [
    "EnergyTankStep",
    "MetricsConfig",
    "begin_metrics",
    "cartesian_impedance",
    "critical_damping",
    "energy_tank",
    "joint_torque",
    "nullspace_torque",
    "orientation_error",
    "power",
    "summarise_metrics",
    "update_metrics",
]
