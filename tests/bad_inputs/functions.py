"""Bad arguments of the pure functions: shapes, types and numbers out of range."""

from __future__ import annotations

import math

import torch

from ppt_rl.functional import (
    MetricsConfig,
    PIDGains,
    ViaPointConfig,
    begin_metrics,
    begin_multiplier,
    braking_part,
    cartesian_impedance,
    catch_up,
    critical_damping,
    damping_factor,
    energy_tank,
    govern_reference,
    impact_tank,
    joint_torque,
    kinetic_energy,
    limit_drive,
    nearest_in_ball,
    nullspace_torque,
    orientation_error,
    parallel_tank,
    passive_tank,
    pid_multiplier,
    power,
    project_half_space,
    project_half_spaces,
    rate_tank,
    recent_motion,
    spring_energy,
    stiffness_factor,
    summarise_metrics,
    update_metrics,
)
from ppt_rl.functional import promp as law
from ppt_rl.functional.contact import is_touching, wall_contact
from ppt_rl.functional.contact_via_point import begin_via_points
from ppt_rl.functional.heading import follow_heading, from_heading, to_heading
from ppt_rl.functional.metrics import low_pass
from ppt_rl.functional.promp_fit import fit_em, fit_ridge
from ppt_rl.functional.rotations import (
    matrix_to_quat,
    quat_conjugate,
    quat_from_yaw,
    quat_multiply,
    quat_rotate,
    quat_to_matrix,
    vee,
    yaw_from_quat,
)
from tests.bad_inputs.entry import bad, each

__all__ = ["ENTRIES"]

_POSE, _TWIST, _ONE = torch.zeros(2, 7), torch.zeros(2, 6), torch.zeros(2, 1)
_METRICS = MetricsConfig()
_TANK = {"p_max": 2.0, "e_max": 3.0, "dt": 0.01}
_PRIOR = law.Gaussian(torch.zeros(4), torch.eye(4))
_SLIDE = {"dt": 0.01, "distance": 0.02, "patience": 0.3, "slow": 0.01}
_SEEN = (torch.zeros(2, 4), torch.zeros(2), torch.eye(2), torch.ones(2, dtype=torch.bool))

_OPTION = "{name} is {value}; expected a number from 0"
_MULTIPLIER = [
    *(
        entry
        for name in ("proportional", "integral", "derivative", "smoothing")
        for entry in each(PIDGains, name, (-1.0, math.nan, math.inf, "much", None), _OPTION)
    ),
    *each(PIDGains, "smoothing", (1.0,), _OPTION),
    *each(PIDGains, "max_multiplier", (0.0, -1.0, math.nan, "large"), "{name} is {value}; expected a number from"),
    bad(pid_multiplier, "cost holds 1 NaN", begin_multiplier(torch.zeros(())), torch.tensor(math.nan), 1.0, PIDGains()),
]
_IMPEDANCE = [
    bad(orientation_error, r"quat has shape \(2, 3\); expected \(\*batch, 4\)", torch.zeros(2, 3), torch.zeros(2, 4)),
    bad(orientation_error, r"reference_quat has shape \(2, 7\)", torch.zeros(2, 4), torch.zeros(2, 7)),
    bad(orientation_error, r"quat \(2, 4\), reference_quat \(3, 4\)", torch.zeros(2, 4), torch.zeros(3, 4)),
    bad(orientation_error, r"quat is \[1, 0, 0, 0\], of type list", [1, 0, 0, 0], torch.zeros(4)),
    bad(critical_damping, r"stiffness has shape \(5,\)", torch.ones(5), torch.ones(6), torch.ones(6)),
    bad(critical_damping, r"inertia has shape \(2, 3\)", torch.ones(6), torch.ones(6), torch.ones(2, 3)),
    bad(cartesian_impedance, r"pose has shape \(2, 6\)", _TWIST, _TWIST, _POSE, _TWIST, _TWIST, _TWIST),
    bad(cartesian_impedance, r"twist has shape \(2, 7\)", _POSE, _POSE, _POSE, _TWIST, _TWIST, _TWIST),
    bad(cartesian_impedance, r"stiffness has shape \(2, 1\)", _POSE, _TWIST, _POSE, _TWIST, _ONE, _TWIST),
    bad(cartesian_impedance, r"damping is None", _POSE, _TWIST, _POSE, _TWIST, _TWIST, None),
    bad(joint_torque, r"wrench has shape \(2, 7\)", torch.zeros(2, 6, 7), _POSE),
    bad(joint_torque, r"jacobian has shape \(2, 7, 6\).*expected \(\*batch, 6, N\)", torch.zeros(2, 7, 6), _TWIST),
    bad(joint_torque, r"jacobian\[..., 0\] \(3, 6\), wrench \(2, 6\)", torch.zeros(3, 6, 7), _TWIST),
    bad(nullspace_torque, r"torque has shape \(2, 6\)", torch.zeros(2, 6, 7), _TWIST, torch.ones(7)),
    bad(nullspace_torque, r"inertia has shape \(6,\)", torch.zeros(2, 6, 7), _POSE, torch.ones(6)),
    bad(nullspace_torque, r"jacobian has shape \(6,\)", torch.zeros(6), _POSE, torch.ones(7)),
    bad(power, r"flow has shape \(2, 7\); expected \(\*batch, 6\)", _TWIST, _POSE),
    bad(power, r"flow has shape \(2, 1\)", _TWIST, _ONE),
    bad(power, r"effort \(2, 6\), flow \(3, 6\)", _TWIST, torch.zeros(3, 6)),
    bad(power, r"effort is None", None, _TWIST),
]
_TANKS = [
    bad(energy_tank, r"(flow|velocity).*\(2, 7\)", _TWIST, _POSE, _ONE, **_TANK),
    bad(energy_tank, r"(tank_energy|energy).*\(2, 6\)", _TWIST, _TWIST, _TWIST, **_TANK),
    bad(energy_tank, r"tank_energy holds 2 NaN", _TWIST, _TWIST, _ONE * math.nan, **_TANK),
    bad(energy_tank, r"flow holds 12 NaN", _TWIST + 1, _TWIST * math.nan, _ONE, **_TANK),
    bad(passive_tank, r"flow.*\(2, 7\)", _TWIST, _POSE, _ONE, **_TANK),
    bad(parallel_tank, r"damping has shape \(2, 7\)", _TWIST, _TWIST, _ONE, damping=_POSE, **_TANK),
    bad(parallel_tank, r"damping holds 12 NaN", _TWIST, _TWIST, _ONE, damping=_TWIST * math.nan, **_TANK),
    bad(rate_tank, r"inertia has shape \(7,\)", _TWIST, _TWIST, _ONE, inertia=torch.ones(7), **_TANK),
    bad(impact_tank, r"inertia has shape \(7,\)", _TWIST, _TWIST, _ONE, inertia=torch.ones(7), **_TANK),
    bad(
        impact_tank, r"stored has shape \(2,\)", _TWIST, _TWIST, _ONE, inertia=torch.ones(6), stored=_ONE[:, 0], **_TANK
    ),
    bad(recent_motion, r"inertia has shape \(7,\)", _TWIST, torch.ones(7), None, dt=0.01),
    bad(recent_motion, r"before.*shape \(2,\)", _TWIST, torch.ones(6), _ONE[:, 0], dt=0.01),
    bad(braking_part, r"reference_twist has shape \(2, 7\)", _TWIST, _POSE, _TWIST),
]
_REACH = {"limits": (20.0, 2.0)}
_FORCES = [
    bad(limit_drive, r"pose has shape \(2, 6\)", _TWIST, _POSE, _TWIST, _TWIST, _TWIST, **_REACH),
    bad(limit_drive, r"damping has shape \(2, 1\)", _POSE, _POSE, _TWIST, _TWIST, _ONE, **_REACH),
    bad(limit_drive, r"moving has shape \(2, 7\)", _POSE, _POSE, _TWIST, _TWIST, _TWIST, moving=_POSE, **_REACH),
    bad(catch_up, r"lag has shape \(2, 1\)", _POSE, _TWIST, _POSE, _ONE, speeds=(0.2, 1.0), dt=0.01),
    bad(
        govern_reference,
        r"reference .* has shape \(2, 7\); expected \(\*batch, 13\)",
        _POSE,
        _POSE,
        _TWIST,
        _TWIST,
        _POSE,
        _ONE,
        speeds=(0.2, 1.0),
        dt=0.01,
        **_REACH,
    ),
    bad(spring_energy, r"error has shape \(2, 7\)", _POSE, _TWIST),
    bad(kinetic_energy, r"inertia has shape \(2, 1\)", _TWIST, _ONE),
    bad(stiffness_factor, r"potential has shape \(2, 6\)", _ONE, _TWIST, 1.0),
    bad(damping_factor, r"most has shape \(2, 6\)", _TWIST, _TWIST, _TWIST, 2.0, _TWIST),
    bad(project_half_space, r"normal has shape \(2, 7\)", _TWIST, _POSE, _ONE),
    bad(project_half_spaces, "there are 5 constraints; expected 1 to 4", _TWIST, torch.ones(2, 5, 6), torch.ones(2, 5)),
    bad(project_half_spaces, r"offsets has shape \(2, 1\)", _TWIST, torch.ones(2, 3, 6), _ONE),
    bad(nearest_in_ball, r"last has shape \(2, 7\)", _TWIST, torch.ones(2, 1, 6), _ONE, _POSE, 1.0),
]
_MEASURES = [
    *each(
        low_pass, "cutoff", (0.0, math.nan, math.inf, "fast"), "{name} is {value}; expected a finite number", dt=0.01
    ),
    *each(low_pass, "dt", (0.0, -0.01, math.nan), "{name} is {value}; expected a finite number", cutoff=10.0),
    bad(low_pass, r"cutoff is 50.0 Hz; expected a frequency below half the control rate", 50.0, 0.01),
    bad(begin_metrics, r"twist has shape \(2, 7\)", _POSE, _TWIST, _METRICS, dt=0.01),
    bad(begin_metrics, r"wrench has shape \(2, 7\)", _TWIST, _POSE, _METRICS, dt=0.01),
    bad(begin_metrics, r"twist \(2, 6\), wrench \(3, 6\)", _TWIST, torch.zeros(3, 6), _METRICS, dt=0.01),
    bad(update_metrics, r"memory has shape \(2, 6\)", _TWIST, _TWIST, _TWIST, _ONE, _METRICS, dt=0.01),
    bad(update_metrics, r"power has shape \(2, 6\)", torch.zeros(2, 283), _TWIST, _TWIST, _TWIST, _METRICS, dt=0.01),
    bad(summarise_metrics, r"memory has shape \(2, 7\)", _POSE),
]
_PRIMITIVES = [
    *each(law.spread_centres, "num_basis", (0, 1, 2.5, "eight", 10**9), "{name} is {value}; expected a whole number"),
    *each(law.spread_centres, "overlap", (0.0, math.nan), "{name} is {value}; expected a finite", num_basis=4),
    bad(law.basis, r"widths has shape \(3,\); expected \(\*batch, 4\)", torch.zeros(2), torch.zeros(4), torch.ones(3)),
    bad(law.basis, r"phase is 0.5, of type float; expected Tensor", 0.5, torch.zeros(4), torch.ones(4)),
    bad(law.vec, r"weights has shape \(4,\); expected \(\*batch, K, D\)", torch.zeros(4)),
    bad(law.unvec, r"vector has shape \(2, 7\); expected .*a multiple of 4", torch.zeros(2, 7), 4),
    *each(law.unvec, "num_basis", (0, -2, "all"), "{name} is {value}; expected a whole number", torch.zeros(2, 8)),
    bad(law.decode, r"basis_matrix \(5, 4\), weights \(3, 2\)", torch.zeros(5, 4), torch.zeros(3, 2)),
    bad(law.observation_matrix, "num_dof is 0; expected a whole number", torch.zeros(2, 4), 0),
    bad(
        law.condition,
        r"observation has shape \(2, 3\); expected \(\*batch, R, 4\)",
        _PRIOR,
        torch.zeros(2, 3),
        *_SEEN[1:],
    ),
    bad(law.condition, r"value has shape \(3,\)", _PRIOR, _SEEN[0], torch.zeros(3), *_SEEN[2:]),
    bad(law.condition, r"cov has shape \(3, 3\)", _PRIOR, *_SEEN[:2], torch.eye(3), _SEEN[3]),
    bad(law.condition, r"mask.*torch.float32.*expected.*bool", _PRIOR, *_SEEN[:3], torch.ones(2)),
    bad(law.condition, r"prior.cov has shape", law.Gaussian(torch.zeros(4), torch.zeros(4)), *_SEEN),
    bad(law.condition, r"cov.*positive", _PRIOR, *_SEEN[:2], -torch.eye(2), _SEEN[3]),
    bad(law.block_diagonal, r"blocks has shape \(2, 3, 4\); expected \(\*batch, M, D, D\)", torch.zeros(2, 3, 4)),
    bad(law.block_diagonal, r"blocks has shape \(3,\)", torch.zeros(3)),
]
_DEMONSTRATIONS = [
    bad(fit_ridge, r"trajectories has shape \(5, 2\); expected \(N, T, D\)", torch.zeros(5, 2), torch.ones(5, 4), 1e-6),
    bad(
        fit_ridge, r"basis_matrix has shape \(6, 4\); expected \(\*batch, 5, K\)",
        torch.zeros(3, 5, 2), torch.zeros(6, 4), 1e-6,
    ),
    *each(
        fit_ridge, "ridge", (0.0, -1.0, math.nan, "small"), "{name} is {value}; expected a finite number above 0",
        torch.ones(3, 5, 2), torch.ones(5, 4),
    ),
    bad(fit_em, r"mask has shape \(3, 4\)", torch.zeros(3, 5, 2), torch.ones(3, 4).bool(), torch.ones(3, 5, 4), 1e-6),
    bad(fit_em, "mask is False everywhere", torch.zeros(3, 5, 2), torch.zeros(3, 5).bool(), torch.ones(3, 5, 4), 1e-6),
    bad(
        fit_em, "iterations is 0; expected a whole number", torch.ones(3, 5, 2), torch.ones(3, 5).bool(),
        torch.ones(3, 5, 4), 1e-6, iterations=0,
    ),
]  # fmt: skip
_ROTATIONS = [
    bad(quat_multiply, r"a has shape \(2, 3\); expected \(\*batch, 4\)", torch.zeros(2, 3), torch.zeros(2, 4)),
    bad(quat_multiply, r"b has shape \(2, 5\)", torch.zeros(2, 4), torch.zeros(2, 5)),
    bad(quat_multiply, r"a \(2, 4\), b \(3, 4\)", torch.zeros(2, 4), torch.zeros(3, 4)),
    bad(quat_conjugate, r"quat has shape \(3,\)", torch.zeros(3)),
    bad(quat_rotate, r"vector has shape \(2, 6\); expected \(\*batch, 3\)", torch.zeros(2, 4), _TWIST),
    bad(quat_to_matrix, r"quat has shape \(2, 7\)", _POSE),
    bad(matrix_to_quat, r"matrix has shape \(2, 4, 4\); expected \(\*batch, 3, 3\)", torch.zeros(2, 4, 4)),
    bad(matrix_to_quat, r"matrix has shape \(3,\)", torch.zeros(3)),
    bad(quat_from_yaw, "yaw is 0.3, of type float; expected Tensor", 0.3),
    bad(yaw_from_quat, r"quat has shape \(2, 3\)", torch.zeros(2, 3)),
    bad(vee, r"matrix has shape \(3,\); expected \(\*batch, 3, 3\)", torch.zeros(3)),
]
_TOUCH = [
    bad(to_heading, r"vector has shape \(2, 4\); expected \(\*batch, 3\) or \(\*batch, 6\)", torch.zeros(2, 4), _ONE),
    bad(to_heading, r"heading has shape \(2, 3\); expected \(\*batch, 1\)", torch.zeros(2, 3), torch.zeros(2, 3)),
    bad(to_heading, "heading is 0.5, of type float", torch.zeros(2, 3), 0.5),
    bad(from_heading, r"vector has shape \(\)", torch.zeros(()), torch.zeros(1)),
    bad(from_heading, r"vector \(2, 6\), heading \(3, 1\)", _TWIST, torch.zeros(3, 1)),
    bad(follow_heading, r"velocity has shape \(2, 6\)", _ONE, _TWIST, torch.zeros(2, 2), _ONE > 0, **_SLIDE),
    bad(follow_heading, r"heading has shape \(2, 2\)", *[torch.zeros(2, 2)] * 3, _ONE > 0, **_SLIDE),
    bad(follow_heading, r"tangent has shape \(2, 3\)", _ONE, torch.zeros(2, 2), torch.zeros(2, 3), _ONE > 0, **_SLIDE),
    bad(wall_contact, r"force has shape \(2, 2\)", torch.zeros(2, 2), torch.zeros(2, 2), _ONE, friction=0.2, slow=0.01),
    bad(wall_contact, r"velocity has shape \(2, 3\)", *[torch.zeros(2, 3)] * 2, _ONE, friction=0.2, slow=0.01),
    bad(is_touching, r"touching.*torch.float32.*expected.*bool", _ONE, _ONE, on=1.0, off=0.5),
    bad(begin_via_points, r"pose has shape \(2, 6\)", _TWIST, ViaPointConfig()),
]

ENTRIES = [
    *_MULTIPLIER,
    *_IMPEDANCE,
    *_TANKS,
    *_FORCES,
    *_MEASURES,
    *_PRIMITIVES,
    *_DEMONSTRATIONS,
    *_ROTATIONS,
    *_TOUCH,
]
