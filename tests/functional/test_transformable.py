"""The pure functions under ``torch.vmap`` and ``torch.compile``."""

from __future__ import annotations

import pytest
import torch
from torch.utils import _pytree as pytree

from ppt_rl.functional import (
    MetricsConfig,
    PIDGains,
    ViaPointConfig,
    begin_metrics,
    begin_multiplier,
    braking_part,
    cartesian_impedance,
    critical_damping,
    damping_factor,
    energy_tank,
    govern_reference,
    impact_tank,
    joint_torque,
    nullspace_torque,
    orientation_error,
    parallel_tank,
    passive_tank,
    penalised,
    pid_multiplier,
    power,
    project_half_spaces,
    promp,
    rate_tank,
    recent_motion,
    rotations,
    stiffness_factor,
    summarise_metrics,
    update_metrics,
)
from ppt_rl.functional.checks import require_finite
from ppt_rl.functional.contact import is_touching, wall_contact
from ppt_rl.functional.contact_via_point import begin_via_points, update_via_points
from ppt_rl.functional.heading import follow_heading, from_heading, to_heading
from ppt_rl.functional.joints import joint_difference, joint_effort
from tests.sampling import normal, random_quats

B, F64 = 5, torch.float64
CONFIG, VIA = MetricsConfig(), ViaPointConfig(capacity=3)


def positive(*shape):
    return normal(*shape).abs() + 0.1


def flags(*shape):
    return normal(*shape, seed=9) > 0


def quats():
    return random_quats(B)


def poses(seed=0):
    return torch.cat([normal(B, 3, seed=seed), random_quats(B, seed=seed)], -1)


def condition(mean, cov, observation, value, noise, mask):
    return promp.condition(promp.Gaussian(mean, cov), observation, value, noise, mask)


def spd(size):
    factor = normal(B, size, size)
    return factor @ factor.mT + torch.eye(size, dtype=F64)


def tank(effort, flow, energy):
    return energy_tank(effort, flow, energy, p_max=1.0, e_max=3.0, dt=0.01)


def passive(effort, flow, energy):
    return passive_tank(effort, flow, energy, p_max=1.0, e_max=3.0, dt=0.01)


def parallel(effort, flow, energy):
    return parallel_tank(effort, flow, energy, p_max=1.0, e_max=3.0, dt=0.01, damping=-0.5 * flow)


def rate(effort, flow, energy):
    inertia = torch.ones(effort.shape[-1], dtype=effort.dtype)
    return rate_tank(effort, flow, energy, p_max=1.0, e_max=3.0, dt=0.01, inertia=inertia)


def impact(effort, flow, energy):
    inertia = torch.ones(effort.shape[-1], dtype=effort.dtype)
    stored = recent_motion(flow, inertia, energy, dt=0.01)
    return impact_tank(effort, flow, energy, p_max=1.0, e_max=3.0, dt=0.01, inertia=inertia, stored=stored)


def touch_and_place(pose, force, velocity, heading):
    wall = wall_contact(force, velocity, heading, friction=0.25, slow=0.01)
    contact = is_touching(heading > 0, force[..., :1].abs(), on=0.5, off=0.1)
    return update_via_points(begin_via_points(pose, VIA), pose, wall, contact, VIA, duration=1.0, dt=0.01)


def measured(twist, wrench):
    memory = begin_metrics(twist, wrench, CONFIG, dt=0.01)
    return summarise_metrics(update_metrics(memory, 2 * twist, wrench, power(wrench, twist), CONFIG, dt=0.01))


def governed(reference, twist, pose, last, moving, stiffness, damping):
    asked, lag = torch.cat([reference, twist], -1), reference[..., :2].abs()
    return govern_reference(
        asked, pose, stiffness, damping, last, lag, limits=(9.0, 1.0), speeds=(0.2, 1.0), dt=0.01, moving=moving
    )


#: Functions of tensors, each with arguments that have a batch dimension.
CASES = {
    "passive_tank": (passive, lambda: (normal(B, 6), normal(B, 6, seed=1), positive(B, 1))),
    "parallel_tank": (parallel, lambda: (normal(B, 6), normal(B, 6, seed=1), positive(B, 1))),
    "rate_tank": (rate, lambda: (normal(B, 6), normal(B, 6, seed=1), positive(B, 1))),
    "impact_tank": (impact, lambda: (normal(B, 6), normal(B, 6, seed=1), positive(B, 1))),
    "braking_part": (braking_part, lambda: (normal(B, 6), normal(B, 6, seed=1), positive(B, 6))),
    "energy_tank": (tank, lambda: (normal(B, 6), normal(B, 6, seed=1), positive(B, 1))),
    "cartesian_impedance": (
        cartesian_impedance,
        lambda: (poses(), normal(B, 6), poses(1), normal(B, 6, seed=1), positive(B, 6), positive(B, 6)),
    ),
    "govern_reference": (
        governed,
        lambda: (
            poses(), normal(B, 6), poses(1), poses(2), normal(B, 6, seed=1), positive(B, 6), positive(B, 6)
        ),
    ),
    "stiffness_factor": (lambda t, v: stiffness_factor(t, v, 0.7), lambda: (positive(B, 1), positive(B, 1))),
    "damping_factor": (
        lambda *a: damping_factor(*a[:3], 0.1, 1 + a[3]),
        lambda: (9 * normal(B, 6), normal(B, 6, seed=1), positive(B, 6), positive(B, 1)),
    ),
    "project_half_spaces": (
        project_half_spaces, lambda: (normal(B, 3), normal(B, 2, 3, seed=1), normal(B, 2, seed=2))
    ),
    "orientation_error": (orientation_error, lambda: (quats(), random_quats(B, seed=3))),
    "critical_damping": (critical_damping, lambda: (positive(B, 6), positive(B, 6), positive(B, 6))),
    "joint_torque": (joint_torque, lambda: (normal(B, 6, 7), normal(B, 6))),
    "nullspace_torque": (nullspace_torque, lambda: (normal(B, 6, 7), normal(B, 7), positive(B, 7)[:1].expand(B, 7))),
    "power": (power, lambda: (normal(B, 6), normal(B, 6, seed=1))),
    "joint_difference": (joint_difference, lambda: (9 * normal(B, 3), normal(B, 3, seed=1), flags(B, 3))),
    "joint_effort": (joint_effort, lambda: (normal(B, 3), normal(B, 3), positive(B, 3), positive(B, 3))),
    "basis": (promp.basis, lambda: (positive(B), normal(B, 4)[:1].expand(B, 4), positive(B, 4)[:1].expand(B, 4))),
    "decode": (promp.decode, lambda: (normal(B, 9, 4), normal(B, 4, 2))),
    "vec": (promp.vec, lambda: (normal(B, 4, 2),)),
    "unvec": (lambda v: promp.unvec(v, 4), lambda: (normal(B, 8),)),
    "observation_matrix": (lambda rows: promp.observation_matrix(rows, 2), lambda: (normal(B, 3, 4),)),
    "block_diagonal": (promp.block_diagonal, lambda: (normal(B, 3, 2, 2),)),
    "condition": (
        condition, lambda: (normal(B, 8), spd(8), normal(B, 6, 8), normal(B, 6), spd(6), flags(B, 6))
    ),
    "wall_contact": (
        lambda *a: wall_contact(*a, friction=0.2, slow=0.01), lambda: (normal(B, 3), normal(B, 2), normal(B, 1))
    ),
    "is_touching": (lambda *a: is_touching(*a, on=1.0, off=0.5), lambda: (flags(B, 1), positive(B, 1))),
    "update_via_points": (
        touch_and_place, lambda: (poses(), normal(B, 3), normal(B, 2), normal(B, 1))
    ),
    "to_heading": (to_heading, lambda: (normal(B, 6), normal(B, 1))),
    "from_heading": (from_heading, lambda: (normal(B, 3), normal(B, 1))),
    "follow_heading": (
        lambda *a: follow_heading(*a, dt=0.01, distance=0.02, patience=0.3, slow=0.01),
        lambda: (normal(B, 1), normal(B, 2), normal(B, 2), flags(B, 1)),
    ),
    "pid_multiplier": (
        lambda cost: pid_multiplier(begin_multiplier(torch.ones_like(cost)), cost, 1.0, PIDGains()),
        lambda: (positive(B, 1),),
    ),
    "penalised": (penalised, lambda: (normal(B, 1), normal(B, 1, seed=1), positive(B, 1))),
    "update_metrics": (measured, lambda: (normal(B, 6), normal(B, 6, seed=1))),
    "quat_multiply": (rotations.quat_multiply, lambda: (quats(), random_quats(B, seed=3))),
    "quat_rotate": (rotations.quat_rotate, lambda: (quats(), normal(B, 3))),
    "matrix_to_quat": (lambda q: rotations.matrix_to_quat(rotations.quat_to_matrix(q)), lambda: (quats(),)),
    "yaw_from_quat": (rotations.yaw_from_quat, lambda: (quats(),)),
}  # fmt: skip


def assert_close(one, other):
    one, other = pytree.tree_leaves(one), pytree.tree_leaves(other)
    assert len(one) == len(other) > 0
    for a, b in zip(one, other, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-9, atol=1e-9)


def batched(name, function, arguments):
    """The function on the batch; arguments that it takes without one come from the first of its equal rows."""
    shared = {"nullspace_torque": (2,), "basis": (1, 2)}.get(name, ())
    return function(*(value[0] if i in shared else value for i, value in enumerate(arguments)))


@pytest.mark.parametrize("name", CASES)
def test_mapping_over_the_rows_gives_what_the_batch_gives(name):
    function, make = CASES[name]
    arguments = make()
    assert_close(torch.vmap(function)(*arguments), batched(name, function, arguments))


@pytest.mark.parametrize("backend", ["eager", "aot_eager"])
@pytest.mark.parametrize(
    "name", ["energy_tank", "cartesian_impedance", "govern_reference", "joint_effort", "wall_contact", "decode"]
)
def test_a_function_compiles_into_one_graph_and_gives_the_same(name, backend):
    function, make = CASES[name]
    torch._dynamo.reset()
    assert_close(torch.compile(function, fullgraph=True, backend=backend)(*make()), function(*make()))


def test_jacobians_by_functional_transforms_equal_those_of_autograd():
    effort, flow, energy = (value[0] for value in CASES["energy_tank"][1]())

    def valve(effort):
        return tank(effort, flow, energy).valve

    assert_close(torch.func.jacrev(valve)(effort), torch.autograd.functional.jacobian(valve, effort))


# -- where there are numbers, they are still checked -------------------------------------------------------------------


def test_numbers_that_are_not_finite_are_refused_again_once_the_mapping_is_over():
    bad = torch.tensor([1.0, float("nan")])
    assert torch.vmap(lambda x: require_finite("it", x) or x)(bad).isnan().any()
    with pytest.raises(ValueError, match="it holds 1 NaN"):
        require_finite("it", bad)


def test_a_compiled_function_passes_on_what_is_not_finite():
    torch._dynamo.reset()
    compiled = torch.compile(tank, fullgraph=True, backend="eager")
    effort, flow, energy = CASES["energy_tank"][1]()
    effort[0, 0] = float("nan")
    with pytest.raises(ValueError, match="NaN or infinite"):
        tank(effort, flow, energy)
    assert_close(compiled(effort, flow, energy).energy[1:], tank(effort[1:], flow[1:], energy[1:]).energy)
