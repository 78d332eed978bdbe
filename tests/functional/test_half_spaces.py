from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from torch.testing import assert_close

from ppt_rl.functional import nearest_in_ball, project_half_space, project_half_spaces
from tests.sampling import normal

F32, F64 = torch.float32, torch.float64
each_dtype = pytest.mark.parametrize("dtype", [F32, F64], ids=["float32", "float64"])
LAWS = settings(max_examples=10, deadline=None, derandomize=True)
SEEDS = st.integers(0, 10**6)
COUNTS = st.integers(1, 4)
SIZES = st.floats(-4.0, 6.0).map(lambda e: 10.0**e)


def drawn(seed, count, size=1.0, rows=6, n=3, dtype=F64):
    """Effort, normals and offsets of constraints that some effort satisfies."""
    effort = size * normal(rows, n, seed=seed)
    normals = normal(rows, count, n, seed=seed + 1)
    inside = size * normal(rows, n, seed=seed + 2)
    offsets = (normals @ inside.unsqueeze(-1)).squeeze(-1) + 0.1 * size * normal(rows, count, seed=seed + 3).abs()
    return effort.to(dtype), normals.to(dtype), offsets.to(dtype), inside.to(dtype)


def excess(value, normals, offsets):
    return (normals @ value.unsqueeze(-1)).squeeze(-1) - offsets


def rounding(dtype, effort, offsets):
    return 2e3 * torch.finfo(dtype).eps * (1 + effort.norm(dim=-1, keepdim=True) + offsets.abs().amax(-1, keepdim=True))


@each_dtype
@LAWS
@given(seed=SEEDS, count=COUNTS, size=SIZES)
def test_the_result_satisfies_every_constraint(dtype, seed, count, size):
    effort, normals, offsets, _ = drawn(seed, count, size, dtype=dtype)
    value = project_half_spaces(effort, normals, offsets)
    assert (excess(value, normals, offsets) <= rounding(dtype, effort, offsets)).all()


@each_dtype
@LAWS
@given(seed=SEEDS, count=COUNTS)
def test_an_effort_within_the_constraints_passes_bit_by_bit(dtype, seed, count):
    _, normals, offsets, inside = drawn(seed, count, dtype=dtype)
    within = (excess(inside, normals, offsets) < 0).all(-1)
    assert within.any()
    assert torch.equal(project_half_spaces(inside, normals, offsets)[within], inside[within])
    far = nearest_in_ball(inside, normals, offsets, inside + 0.1, 1.0)
    assert torch.equal(far[within], inside[within])


@LAWS
@given(seed=SEEDS, count=COUNTS, size=SIZES)
def test_the_change_is_a_combination_of_the_active_normals_with_weights_that_are_not_negative(seed, count, size):
    """Together with the constraints these are the conditions of optimality of a convex problem."""
    effort, normals, offsets, _ = drawn(seed, count, size)
    value = project_half_spaces(effort, normals, offsets)
    for change, row, slack in zip(effort - value, normals, -excess(value, normals, offsets), strict=True):
        active = row[slack < 1e-6 * size].T.numpy()
        if not active.size:
            assert not change.any()
            continue
        weights, _, _, _ = np.linalg.lstsq(active, change.numpy(), rcond=None)
        assert np.allclose(active @ weights, change.numpy(), atol=1e-6 * size)
        assert (weights >= -1e-6 * size).all() or active.shape[1] > 3


def optimum(effort, normals, offsets, last=None, most=None):
    """The same problem by sequential quadratic programming."""
    u, a, b = effort.numpy(), normals.numpy(), offsets.numpy()
    constraints = [{"type": "ineq", "fun": lambda x: b - a @ x, "jac": lambda x: -a}]
    if last is not None:
        c = last.numpy()
        constraints.append(
            {"type": "ineq", "fun": lambda x: most**2 - (x - c) @ (x - c), "jac": lambda x: -2 * (x - c)[None]}
        )
    found = minimize(
        lambda x: 0.5 * (x - u) @ (x - u), u if last is None else c, jac=lambda x: x - u, constraints=constraints,
        method="SLSQP", options={"maxiter": 300, "ftol": 1e-12 if last is None else 1e-10},
    )  # fmt: skip
    return torch.from_numpy(found.x), found.success or found.status == 8  # 8: no descent left


@pytest.mark.parametrize("count", [1, 2, 3, 4])
@pytest.mark.parametrize("n", [3, 7])
def test_the_result_is_that_of_a_general_solver(count, n):
    effort, normals, offsets, _ = drawn(11 * count + n, count, rows=10, n=n)
    value = project_half_spaces(effort, normals, offsets)
    for row, expected in enumerate(map(optimum, effort, normals, offsets)):
        assert expected[1]
        assert_close(value[row], expected[0], rtol=0, atol=1e-5)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_with_a_largest_change_the_result_is_that_of_a_general_solver(count):
    effort, normals, offsets, inside = drawn(5 * count, count, size=5.0, rows=10)
    value = nearest_in_ball(effort, normals, offsets, inside, 2.0)
    assert ((value - inside).norm(dim=-1) <= 2.0 + 1e-8).all()
    assert (excess(value, normals, offsets) <= 1e-9).all()
    assert ((value - inside).norm(dim=-1) > 1.999).sum() > 3
    for row in range(10):
        expected, success = optimum(effort[row], normals[row], offsets[row], inside[row], 2.0)
        assert success, row
        assert_close(value[row], expected, rtol=0, atol=1e-4)


@each_dtype
@LAWS
@given(seed=SEEDS, count=COUNTS, most=st.floats(0.01, 10.0))
def test_the_change_from_the_last_effort_is_within_its_limit_wherever_the_constraints_allow_it(
    dtype, seed, count, most
):
    effort, normals, offsets, inside = drawn(seed, count, 3.0, dtype=dtype)
    value = nearest_in_ball(effort, normals, offsets, inside, most)
    assert ((value - inside).norm(dim=-1, keepdim=True) <= most + rounding(dtype, effort, offsets)).all()
    assert (excess(value, normals, offsets) <= rounding(dtype, effort, offsets)).all()


@LAWS
@given(seed=SEEDS, count=COUNTS)
def test_where_the_last_effort_is_too_far_away_the_constraints_win_and_the_change_is_the_smallest_possible(seed, count):
    effort, normals, offsets, _ = drawn(seed, count)
    last = effort + 20 * normals[:, 0]  # far outside
    value = nearest_in_ball(effort, normals, offsets, last, 0.01)
    assert (excess(value, normals, offsets) <= 1e-8).all()
    assert_close(value, project_half_spaces(last, normals, offsets), rtol=0, atol=1e-6)


def test_parallel_repeated_and_empty_constraints_are_taken_in_stride():
    effort = torch.tensor([[3.0, 1.0, 0.0]], dtype=F64)
    normals = torch.tensor([[[1.0, 0, 0], [2.0, 0, 0], [0.0, 0, 0], [-1.0, 0, 0]]], dtype=F64)
    offsets = torch.tensor([[2.0, 2.0, -5.0, 4.0]], dtype=F64)
    assert project_half_spaces(effort, normals, offsets).tolist() == [[1.0, 1.0, 0.0]]
    assert torch.equal(project_half_space(effort, 0 * effort, effort[:, :1]), effort)


def test_of_constraints_that_contradict_each_other_the_violation_is_the_least_of_the_candidates():
    effort = torch.tensor([[0.0, 0.0]], dtype=F64)
    normals = torch.tensor([[[1.0, 0.0], [-1.0, 0.0]]], dtype=F64)  # x <= -1 and x >= 1
    value = project_half_spaces(effort, normals, torch.tensor([[-1.0, -1.0]], dtype=F64))
    assert value.isfinite().all()
    assert excess(value, normals, -torch.ones(1, 2, dtype=F64)).max() <= 2.0


@LAWS
@given(seed=SEEDS, count=COUNTS)
def test_projecting_twice_or_in_another_order_changes_nothing(seed, count):
    effort, normals, offsets, _ = drawn(seed, count)
    value = project_half_spaces(effort, normals, offsets)
    assert_close(project_half_spaces(value, normals, offsets), value, rtol=0, atol=1e-8)
    assert_close(project_half_spaces(effort, normals.flip(1), offsets.flip(1)), value, rtol=0, atol=1e-8)


def test_gradients_agree_with_finite_differences():
    for count in (1, 2):
        inputs = [x.requires_grad_() for x in drawn(3 + count, count, rows=3)[:3]]
        assert torch.autograd.gradcheck(project_half_spaces, inputs)
