import math

import pytest
import torch
from torch.testing import assert_close

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
from tests.sampling import normal, random_quats

TIGHT = {"rtol": 0.0, "atol": 1e-12}
A, B, C = (random_quats(50, seed=seed) for seed in range(3))
IDENTITY = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)


def angle_axis(angle: float, axis: torch.Tensor) -> torch.Tensor:
    axis = axis / axis.norm(dim=-1, keepdim=True)
    half = torch.full_like(axis[..., :1], 0.5 * angle)
    return torch.cat([half.cos(), half.sin() * axis], -1)


def test_multiplication_is_associative():
    assert_close(quat_multiply(quat_multiply(A, B), C), quat_multiply(A, quat_multiply(B, C)), **TIGHT)


def test_the_conjugate_is_the_inverse_on_both_sides():
    assert_close(quat_multiply(A, quat_conjugate(A)), IDENTITY.expand_as(A), **TIGHT)
    assert_close(quat_multiply(quat_conjugate(A), A), IDENTITY.expand_as(A), **TIGHT)


def test_the_identity_is_neutral_on_both_sides():
    assert_close(quat_multiply(A, IDENTITY.expand_as(A)), A, **TIGHT)
    assert_close(quat_multiply(IDENTITY.expand_as(A), A), A, **TIGHT)


def test_products_of_unit_quaternions_have_norm_one():
    assert_close(quat_multiply(A, B).norm(dim=-1), torch.ones(50, dtype=torch.float64), **TIGHT)


def test_i_times_j_is_k():
    i, j, k = torch.eye(4)[1:]
    assert torch.equal(quat_multiply(i, j), k)
    assert torch.equal(quat_multiply(j, i), -k)


def test_the_matrix_of_a_product_is_the_product_of_the_matrices():
    assert_close(quat_to_matrix(quat_multiply(A, B)), quat_to_matrix(A) @ quat_to_matrix(B), **TIGHT)


def test_matrices_of_unit_quaternions_are_orthogonal_with_determinant_one():
    matrix = quat_to_matrix(A)
    assert_close(matrix @ matrix.mT, torch.eye(3, dtype=torch.float64).expand(50, 3, 3), **TIGHT)
    assert_close(torch.linalg.det(matrix), torch.ones(50, dtype=torch.float64), **TIGHT)


def test_rotating_by_quaternion_equals_rotating_by_its_matrix():
    vector = normal(50, 3)
    assert_close(quat_rotate(A, vector), (quat_to_matrix(A) @ vector.unsqueeze(-1)).squeeze(-1), **TIGHT)


def test_a_single_quaternion_rotates_a_batch_of_vectors():
    vector = normal(50, 3)
    assert_close(quat_rotate(A[:1], vector), quat_rotate(A[:1].expand(50, 4), vector), **TIGHT)


def test_a_quarter_turn_about_z_takes_x_to_y():
    turned = quat_rotate(quat_from_yaw(torch.tensor(math.pi / 2)), torch.tensor([1.0, 0.0, 0.0]))
    assert_close(turned, torch.tensor([0.0, 1.0, 0.0]))


def test_matrix_to_quat_undoes_quat_to_matrix_up_to_sign():
    back = matrix_to_quat(quat_to_matrix(A))
    assert_close(back, A * A[:, :1].sign(), **TIGHT)
    assert bool((back[:, 0] >= 0).all())


@pytest.mark.parametrize("off", [0.0, 1e-12, 1e-8, 1e-4])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_rotations_by_almost_half_a_turn_survive_the_round_trip(off, dtype):
    axes = torch.cat([torch.eye(3, dtype=torch.float64), normal(50, 3)])
    matrix = quat_to_matrix(angle_axis(math.pi - off, axes)).to(dtype)
    quat = matrix_to_quat(matrix)
    tolerance = 8 * torch.finfo(dtype).eps
    assert_close(quat_to_matrix(quat), matrix, rtol=0.0, atol=tolerance)
    assert_close(quat.norm(dim=-1), torch.ones(53, dtype=dtype), rtol=0.0, atol=tolerance)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1.0, math.pi - 1e-9, math.pi])
def test_the_gradient_of_matrix_to_quat_is_finite(angle):
    matrix = quat_to_matrix(angle_axis(angle, normal(20, 3))).requires_grad_()
    (gradient,) = torch.autograd.grad(matrix_to_quat(matrix).sum(), matrix)
    assert bool(torch.isfinite(gradient).all())


def test_gradients_of_the_other_maps_are_right():
    a, b, v = (x[:3].clone().requires_grad_() for x in (A, B, normal(3, 3)))
    assert torch.autograd.gradcheck(quat_multiply, (a, b))
    assert torch.autograd.gradcheck(quat_rotate, (a, v))
    assert torch.autograd.gradcheck(quat_to_matrix, (a,))
    assert torch.autograd.gradcheck(yaw_from_quat, (a,))


def test_yaw_from_quat_undoes_quat_from_yaw():
    yaw = torch.linspace(-math.pi + 1e-6, math.pi, 101, dtype=torch.float64)
    assert_close(yaw_from_quat(quat_from_yaw(yaw)), yaw, **TIGHT)


def test_pitch_and_roll_applied_before_the_yaw_do_not_change_it():
    x, y, _ = torch.eye(3, dtype=torch.float64)
    tilt = quat_multiply(angle_axis(0.4, y), angle_axis(-0.7, x))
    yaw = torch.tensor(1.1, dtype=torch.float64)
    assert_close(yaw_from_quat(quat_multiply(quat_from_yaw(yaw), tilt)), yaw, **TIGHT)


def test_vee_of_a_cross_product_matrix_is_its_vector():
    v = normal(3)
    matrix = torch.linalg.cross(v.expand(3, 3), torch.eye(3, dtype=torch.float64)).mT
    assert_close(vee(matrix), v)
