import math

import pytest
import torch
from torch.testing import assert_close

from ppt_rl.arms import PANDA
from ppt_rl.functional.impedance import (
    cartesian_impedance,
    critical_damping,
    joint_torque,
    nullspace_torque,
    orientation_error,
    power,
)
from ppt_rl.functional.rotations import quat_multiply, quat_to_matrix, vee
from ppt_rl.modules import Kinematics
from tests.sampling import normal, random_joint_positions, random_poses, random_quats

F64 = torch.float64
TIGHT = {"rtol": 0.0, "atol": 1e-12}
TOOL_DOWN = torch.tensor([0.0, 1.0, 0.0, 0.0], dtype=F64)
INERTIA = torch.tensor(PANDA.joints.inertia, dtype=F64)
#: Shoulder, elbow and wrist in line, with the hand straight and bent: the Jacobian loses rank.
SINGULAR = torch.tensor([[0.0] * 7, [0.5, 0.0, 0.3, 0.0, 0.2, 1.0, 0.0]], dtype=F64)


@pytest.fixture(scope="module")
def kinematics() -> Kinematics:
    return Kinematics(PANDA, 0.16, dtype=F64)


def turn(angle: float, axis: torch.Tensor) -> torch.Tensor:
    axis = axis / axis.norm(dim=-1, keepdim=True)
    half = torch.full_like(axis[..., :1], 0.5 * angle)
    return torch.cat([half.cos(), half.sin() * axis], -1)


def test_the_orientation_error_equals_the_matrix_formula():
    quat, reference = random_quats(1000, seed=1), random_quats(1000, seed=2)
    r, rd = quat_to_matrix(quat), quat_to_matrix(reference)
    expected = -0.5 * (rd @ vee(rd.mT @ r - r.mT @ rd).unsqueeze(-1)).squeeze(-1)
    assert_close(orientation_error(quat, reference), expected, **TIGHT)


def test_a_quaternion_and_its_negative_give_the_same_error():
    quat, reference = random_quats(100, seed=1), random_quats(100, seed=2)
    expected = orientation_error(quat, reference)
    assert torch.equal(orientation_error(-quat, reference), expected)
    assert torch.equal(orientation_error(quat, -reference), expected)


@pytest.mark.parametrize("angle", [1e-6, 1e-3, 0.5, 1.5, 3.0])
def test_the_error_is_minus_the_sine_of_the_angle_along_the_world_axis(angle):
    reference, axis = random_quats(100), normal(100, 3)
    quat = quat_multiply(turn(angle, axis), reference)
    expected = -math.sin(angle) * axis / axis.norm(dim=-1, keepdim=True)
    assert_close(orientation_error(quat, reference), expected, **TIGHT)


def test_small_turns_give_minus_the_rotation_vector():
    angle, axis = 1e-4, normal(100, 3)
    axis = axis / axis.norm(dim=-1, keepdim=True)
    reference = TOOL_DOWN.expand(100, 4)
    error = orientation_error(quat_multiply(turn(angle, axis), reference), reference)
    assert_close(error, -angle * axis, rtol=0.0, atol=angle**3)  # sin x = x - x^3 / 6 + ...


@pytest.mark.parametrize("reference", [TOOL_DOWN, random_quats(seed=7)], ids=["tool down", "random"])
def test_turning_along_the_error_brings_every_orientation_to_the_reference(reference):
    quat = random_quats(200, seed=3)
    reference = reference.expand_as(quat)
    for _ in range(400):
        error = orientation_error(quat, reference)
        spin = torch.cat([torch.ones(200, 1, dtype=F64), 0.05 * error], -1)  # half of a step of 0.1 e_R
        quat = quat_multiply(spin / spin.norm(dim=-1, keepdim=True), quat)
    assert_close((quat * reference).sum(-1).abs(), torch.ones(200, dtype=F64), **TIGHT)


def test_critical_damping_is_twice_the_ratio_times_the_root():
    damping = critical_damping(torch.full((6,), 400.0), torch.full((6,), 0.7), torch.full((6,), 9.0))
    assert_close(damping, torch.full((6,), 84.0))


@pytest.mark.parametrize(
    ("ratio", "crosses"), [(0.5, True), (1.0, False), (1.5, False)], ids=["under", "critical", "over"]
)
def test_a_mass_on_the_spring_and_damper_overshoots_only_below_ratio_one(ratio, crosses):
    stiffness, inertia = torch.full((6,), 400.0, dtype=F64), torch.full((6,), 8.0, dtype=F64)
    damping = critical_damping(stiffness, torch.full((6,), ratio, dtype=F64), inertia)
    roots = [
        complex(root)
        for k, d, m in zip(stiffness, damping, inertia, strict=True)
        for root in torch.linalg.eigvals(torch.tensor([[0.0, 1.0], [-k / m, -d / m]], dtype=F64))
    ]
    assert all(root.real < 0 for root in roots)
    # At ratio 1 the double root splits by the square root of the rounding error.
    assert all((abs(root.imag) > 1e-5) == crosses for root in roots)


def test_the_linear_part_is_spring_plus_damper():
    pose, reference = random_poses(20, seed=1), random_poses(20, seed=2)
    twist, reference_twist = normal(20, 6, seed=3), normal(20, 6, seed=4)
    stiffness, damping = normal(20, 6, seed=5).exp(), normal(20, 6, seed=6).exp()
    wrench = cartesian_impedance(pose, twist, reference, reference_twist, stiffness, damping)
    expected = stiffness[:, :3] * (reference - pose)[:, :3] + damping[:, :3] * (reference_twist - twist)[:, :3]
    assert_close(wrench[:, :3], expected, **TIGHT)


def test_the_angular_part_is_spring_on_the_orientation_error_plus_damper():
    pose, reference = random_poses(20, seed=1), random_poses(20, seed=2)
    twist, reference_twist = normal(20, 6, seed=3), normal(20, 6, seed=4)
    stiffness, damping = normal(20, 6, seed=5).exp(), normal(20, 6, seed=6).exp()
    wrench = cartesian_impedance(pose, twist, reference, reference_twist, stiffness, damping)
    spring = stiffness[:, 3:] * orientation_error(pose[:, 3:], reference[:, 3:])
    assert_close(wrench[:, 3:], spring + damping[:, 3:] * (reference_twist - twist)[:, 3:], **TIGHT)


def test_a_worked_example_of_a_wrench():
    quarter = [math.cos(math.pi / 4), 0.0, 0.0, math.sin(math.pi / 4)]
    wrench = cartesian_impedance(
        torch.tensor([0.4, 0.0, 0.1, *quarter], dtype=F64),
        torch.tensor([0.1, 0.0, 0.0, 0.0, 0.0, 0.2], dtype=F64),
        torch.tensor([0.5, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0], dtype=F64),
        torch.tensor([0.3, 0.0, 0.0, 0.0, 0.0, 0.0], dtype=F64),
        torch.tensor([400.0, 400.0, 400.0, 30.0, 30.0, 30.0], dtype=F64),
        torch.tensor([100.0, 100.0, 100.0, 10.0, 10.0, 10.0], dtype=F64),
    )
    assert_close(wrench, torch.tensor([60.0, 0.0, 0.0, 0.0, 0.0, -32.0], dtype=F64), **TIGHT)


def test_joint_torque_does_the_work_of_the_wrench():
    jacobian, wrench, velocity = normal(20, 6, 7), normal(20, 6, seed=1), normal(20, 7, seed=2)
    twist = (jacobian @ velocity.unsqueeze(-1)).squeeze(-1)
    assert_close(power(joint_torque(jacobian, wrench), velocity), power(wrench, twist))


def test_power_is_positive_when_the_effort_goes_with_the_flow():
    assert_close(power(torch.tensor([1.0, -2.0]), torch.tensor([3.0, -0.5])), torch.tensor([4.0]))


def test_nullspace_torque_does_not_accelerate_the_end_effector_away_from_singularities(kinematics):
    jacobian = kinematics.jacobian(random_joint_positions(500))
    gram = (jacobian / INERTIA) @ jacobian.mT
    jacobian = jacobian[torch.linalg.eigvalsh(gram)[:, 0] > 0.01]
    assert len(jacobian) > 200
    torque, damping = 10 * normal(len(jacobian), 7, seed=1), 1e-5
    projected = nullspace_torque(jacobian, torque, INERTIA, damping)
    acceleration = ((jacobian / INERTIA) @ projected.unsqueeze(-1)).squeeze(-1)
    unprojected = ((jacobian / INERTIA) @ torque.unsqueeze(-1)).squeeze(-1)
    # The damping mu leaves mu^2 / (lambda_min + mu^2) of the acceleration, at most 1e-8 here.
    assert bool((acceleration.norm(dim=-1) <= 1.1e-8 * unprojected.norm(dim=-1)).all())
    assert bool((projected.norm(dim=-1) > 1e-3).all())


def test_nullspace_torque_leaves_a_torque_that_is_already_in_the_nullspace(kinematics):
    jacobian = kinematics.jacobian(torch.tensor(PANDA.home, dtype=F64))
    free = torch.linalg.svd(jacobian)[2][-1]  # J free = 0, so M free accelerates nothing
    torque = INERTIA * free
    assert_close(nullspace_torque(jacobian, torque, INERTIA), torque, **TIGHT)


@pytest.mark.parametrize(("dtype", "rounding"), [(torch.float32, 1e-4), (F64, 1e-12)], ids=["float32", "float64"])
def test_nullspace_torque_never_grows_in_the_inertia_norm_even_at_singular_poses(kinematics, dtype, rounding):
    jacobian = kinematics.jacobian(SINGULAR)
    assert bool((torch.linalg.svdvals(jacobian)[:, -1] < 1e-6).all())
    torque = normal(100, 1, 7).to(dtype)
    projected = nullspace_torque(jacobian.to(dtype), torque, INERTIA.to(dtype))
    before, after = ((t.double().square() / INERTIA).sum(-1) for t in (torque, projected))
    assert bool((after <= before * (1 + rounding)).all())


def test_with_unit_inertia_it_is_the_kinematic_projection(kinematics):
    jacobian = kinematics.jacobian(random_joint_positions(500))
    jacobian = jacobian[torch.linalg.svdvals(jacobian)[:, -1] > 0.1]
    torque = normal(len(jacobian), 7)
    projector = torch.eye(7, dtype=F64) - torch.linalg.pinv(jacobian) @ jacobian
    expected = (projector @ torque.unsqueeze(-1)).squeeze(-1)
    projected = nullspace_torque(jacobian, torque, torch.ones(7, dtype=F64), damping=1e-6)
    assert_close(projected, expected, rtol=0.0, atol=1e-9)


def test_gradients_of_the_laws_are_right(kinematics):
    quats = [random_quats(2, seed=s).requires_grad_() for s in (1, 2)]
    assert torch.autograd.gradcheck(orientation_error, quats)
    jacobian = kinematics.jacobian(torch.tensor(PANDA.home, dtype=F64)).detach().requires_grad_()
    torque = normal(7).requires_grad_()
    assert torch.autograd.gradcheck(lambda j, t: nullspace_torque(j, t, INERTIA), (jacobian, torque))
