from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.testing import assert_close

from ppt_rl.functional import (
    cartesian_impedance,
    damping_factor,
    kinetic_energy,
    power,
    spring_energy,
    stiffness_factor,
)
from ppt_rl.functional.stability import largest_damping_factor, spectral_radius
from tests.sampling import normal, random_poses

F32, F64 = torch.float32, torch.float64
each_dtype = pytest.mark.parametrize("dtype", [F32, F64], ids=["float32", "float64"])
LAWS = settings(max_examples=100, deadline=None, derandomize=True)
STIFFNESS = torch.tensor((400.0, 300.0, 500.0, 30.0, 20.0, 40.0), dtype=F64)
DAMPING = torch.tensor((115.0, 90.0, 118.0, 10.0, 9.5, 3.5), dtype=F64)
INERTIA = torch.tensor((8.35, 4.9, 8.75, 0.91, 0.75, 0.1), dtype=F64)
ENERGIES = st.just(0.0) | st.floats(-30.0, 30.0).map(lambda e: 10.0**e)
LIMITS = st.floats(-3.0, 4.0).map(lambda e: 10.0**e)
SEEDS = st.integers(0, 10**6)
SIZES = st.floats(-6.0, 4.0).map(lambda e: 10.0**e)


def column(value, dtype):
    return torch.tensor([[value]], dtype=dtype)


@each_dtype
@LAWS
@given(kinetic=ENERGIES, potential=ENERGIES, e_max=LIMITS)
def test_spring_and_motion_together_keep_to_the_budget_or_there_is_no_spring(dtype, kinetic, potential, e_max):
    kinetic, potential = column(kinetic, dtype), column(potential, dtype)
    factor = stiffness_factor(kinetic, potential, e_max)
    assert 0 <= factor.item() <= 1
    left = max(0.0, e_max - kinetic.item())
    assert factor.double().item() * potential.double().item() <= left + 2 * torch.finfo(dtype).eps * e_max
    if kinetic.item() + potential.item() <= e_max * (1 - torch.finfo(dtype).eps):
        assert factor.item() == 1.0


@each_dtype
@LAWS
@given(seed=SEEDS, size=SIZES, e_max=LIMITS)
def test_a_resting_tool_is_pressed_with_at_most_the_root_of_twice_stiffness_times_budget(dtype, seed, size, e_max):
    axis = torch.eye(3, 6, dtype=dtype)[seed % 3]
    error, stiffness = (size * axis).unsqueeze(0), STIFFNESS.to(dtype)
    factor = stiffness_factor(column(0.0, dtype), spring_energy(error, stiffness), e_max)
    force = (factor * stiffness * error).norm().item()
    assert force <= math.sqrt(2 * stiffness[seed % 3].item() * e_max) * (1 + 8 * torch.finfo(dtype).eps)


def test_the_bound_on_the_force_is_reached_where_the_spring_holds_the_whole_budget():
    error = torch.zeros(1, 6, dtype=F64)
    error[0, 0] = math.sqrt(2 * 0.5 / 400)
    factor = stiffness_factor(column(0.0, F64), spring_energy(error, STIFFNESS), 0.5 + 1e-12)
    assert (factor * STIFFNESS * error)[0, 0].item() == pytest.approx(math.sqrt(2 * 400 * 0.5))
    assert (
        stiffness_factor(column(0.0, F64), spring_energy(4 * error, STIFFNESS), 0.5) * 4 * error
    ).norm() < error.norm()


@each_dtype
@LAWS
@given(
    seed=SEEDS, force=SIZES | st.floats(1.0, 200.0), fast=SIZES | st.floats(0.01, 0.3), p_max=LIMITS,
    most=st.floats(1.0, 5.0),
)  # fmt: skip
def test_the_power_towards_the_world_is_within_its_limit_whether_or_not_the_damping_may_grow(
    dtype, seed, force, fast, p_max, most
):
    drive, twist = force * normal(8, 6, seed=seed).to(dtype), fast * normal(8, 6, seed=seed + 1).to(dtype)
    damping = DAMPING.to(dtype)
    beta, drive_factor = damping_factor(drive, twist, damping, p_max, column(most, dtype))
    wrench = drive_factor.double() * drive.double() - beta.double() * damping.double() * twist.double()
    terms = (drive * twist).double().abs().sum(-1) + (beta * damping * twist.square()).double().sum(-1)
    assert (power(wrench, twist.double()).squeeze(-1) <= p_max + 8 * torch.finfo(dtype).eps * (terms + p_max)).all()
    assert ((beta >= 1) & (beta <= most * (1 + torch.finfo(dtype).eps))).all()
    assert ((drive_factor >= 0) & (drive_factor <= 1)).all()
    assert (drive_factor[beta < most * (1 - 1e-6)] == 1).all()
    calm = power(drive - damping * twist, twist) < p_max - 8 * torch.finfo(dtype).eps * (terms + p_max).unsqueeze(-1)
    assert (beta[calm] == 1).all()
    assert (drive_factor[calm] == 1).all()


def test_the_added_damping_is_the_smallest_that_keeps_to_the_limit():
    drive, twist = torch.tensor([[100.0, 0, 0, 0, 0, 0]], dtype=F64), torch.tensor([[0.1, 0, 0, 0, 0, 0]], dtype=F64)
    beta, factor = damping_factor(drive, twist, DAMPING, 2.0, column(50.0, F64))
    assert beta.item() == pytest.approx((10.0 - 2.0) / 1.15)
    assert factor.item() == 1.0
    assert power(drive - beta * DAMPING * twist, twist).item() == pytest.approx(2.0)
    beta, factor = damping_factor(drive, twist, DAMPING, 2.0, column(3.0, F64))
    assert (beta.item(), factor.item()) == (3.0, pytest.approx((2.0 + 3 * 1.15) / 10.0))


@LAWS
@given(
    mass=st.floats(0.05, 20.0), ratio=st.floats(0.05, 2.0), stiffness=st.floats(1.0, 2e4),
    dt=st.sampled_from([0.001, 0.01]), share=st.floats(0.0, 1.0),
)  # fmt: skip
def test_up_to_its_largest_factor_the_damping_keeps_a_stable_axis_stable_and_turns_no_velocity_around(
    mass, ratio, stiffness, dt, share
):
    m, k = column(mass, F64), column(stiffness, F64)
    d = column(2 * ratio * math.sqrt(stiffness * mass), F64)
    most = largest_damping_factor(d, m, dt)
    beta = 1 + share * (most - 1)
    if most > 1:
        assert (1 - beta * d * dt / m).item() >= -1e-12
    if spectral_radius(m, k, d, dt) <= 1:
        assert spectral_radius(m, k, beta * d, dt) <= 1 + 1e-9
    stable = stiffness * dt**2 / 2 <= d.item() * dt <= 2 * mass
    radius = spectral_radius(m, k, d, dt).item()
    assert stable == (radius <= 1) or abs(radius - 1) < 1e-9


def test_twice_the_inertia_margin_is_where_the_chatter_begins():
    m, d, dt = column(5.0, F64), column(90.0, F64), 0.01
    most = largest_damping_factor(d, m, dt)
    assert spectral_radius(m, column(400.0, F64), 1.9 * most * d, dt) < 1
    assert spectral_radius(m, column(400.0, F64), 2.1 * most * d, dt) > 1


def test_gradients_agree_with_finite_differences_and_are_finite_at_rest():
    error, twist, reference = (0.3 * normal(6, 6, seed=i) for i in (1, 2, 3))
    error = error * torch.linspace(0.05, 1, 6, dtype=F64).unsqueeze(-1)
    twist = torch.cat([error[:4] * torch.tensor([[8.0], [2.0], [1.0], [0.3]], dtype=F64), twist[4:]])

    def law(error, twist, reference, stiffness, damping):
        factor = stiffness_factor(kinetic_energy(twist, INERTIA), spring_energy(error, stiffness), 20.0)
        drive = factor * (stiffness * error + damping * reference)
        most = largest_damping_factor(damping, INERTIA, 0.01)
        return factor, *damping_factor(drive, twist, damping, 0.05, most)

    inputs = [x.clone().requires_grad_() for x in (error, twist, reference, STIFFNESS, DAMPING)]
    factor, beta, weakened = law(*inputs)
    assert (factor < 1).any()
    assert (factor == 1).any()
    assert (beta > 1).any()
    assert (weakened < 1).any()
    assert torch.autograd.gradcheck(law, inputs)
    still = [(0 * x).requires_grad_() for x in (error, twist, reference)]
    sum(part.sum() for part in law(*still, *inputs[3:])).backward()
    assert all(x.grad.isfinite().all() for x in still)


def test_the_plain_impedance_is_the_case_of_both_factors_one():
    pose, reference = random_poses(4), random_poses(4, seed=1)
    twist, wanted = normal(4, 6), normal(4, 6, seed=1)
    plain = cartesian_impedance(pose, twist, reference, wanted, STIFFNESS, DAMPING)
    one = torch.ones(4, 1, dtype=F64)
    assert_close(
        cartesian_impedance(pose, one * twist, reference, one * wanted, one * STIFFNESS, DAMPING), plain, rtol=0, atol=0
    )
