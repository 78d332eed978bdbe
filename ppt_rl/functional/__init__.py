"""The library's control laws and metrics as pure functions of tensors."""

from ppt_rl.functional.barrier import Barrier, PlaneBarrier, SpeedBarrier
from ppt_rl.functional.contact import WallTouch
from ppt_rl.functional.contact_via_point import ViaPointConfig
from ppt_rl.functional.energy_aware_impedance import (
    PowerFactors,
    damping_factor,
    kinetic_energy,
    spring_energy,
    stiffness_factor,
)
from ppt_rl.functional.energy_tank import TANK_LAWS, EnergyTankStep, TankLaw, energy_tank
from ppt_rl.functional.half_spaces import nearest_in_ball, project_half_space, project_half_spaces
from ppt_rl.functional.impedance import (
    braking_part,
    cartesian_impedance,
    critical_damping,
    joint_torque,
    nullspace_torque,
    orientation_error,
    power,
)
from ppt_rl.functional.lagrangian import MultiplierState, PIDGains, begin_multiplier, penalised, pid_multiplier
from ppt_rl.functional.metrics import MetricsConfig, begin_metrics, summarise_metrics, update_metrics
from ppt_rl.functional.reference_governor import GovernedReference, catch_up, govern_reference, limit_drive
from ppt_rl.functional.tank_ahead import impact_tank, rate_tank, recent_motion
from ppt_rl.functional.tank_laws import parallel_tank, passive_tank

__all__ = [
    "TANK_LAWS",
    "Barrier",
    "EnergyTankStep",
    "GovernedReference",
    "MetricsConfig",
    "MultiplierState",
    "PIDGains",
    "PlaneBarrier",
    "PowerFactors",
    "SpeedBarrier",
    "TankLaw",
    "ViaPointConfig",
    "WallTouch",
    "begin_metrics",
    "begin_multiplier",
    "braking_part",
    "cartesian_impedance",
    "catch_up",
    "critical_damping",
    "damping_factor",
    "energy_tank",
    "govern_reference",
    "impact_tank",
    "joint_torque",
    "kinetic_energy",
    "limit_drive",
    "nearest_in_ball",
    "nullspace_torque",
    "orientation_error",
    "parallel_tank",
    "passive_tank",
    "penalised",
    "pid_multiplier",
    "power",
    "project_half_space",
    "project_half_spaces",
    "rate_tank",
    "recent_motion",
    "spring_energy",
    "stiffness_factor",
    "summarise_metrics",
    "update_metrics",
]
