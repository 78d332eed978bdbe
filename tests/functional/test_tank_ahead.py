"""The laws of the tank that look ahead: formulas, reductions, and velocities that contact may cause."""

import math

import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from torch.testing import assert_close

from ppt_rl.functional import energy_tank, impact_tank, rate_tank, recent_motion
from tests.functional.test_tank_laws import FULLNESS, INERTIA, LAWS, LIMITS, VECTOR, column, each_dtype

# -- rate --------------------------------------------------------------------------------------------------------------


@each_dtype
@settings(LAWS, max_examples=80)
@given(
    force=st.floats(-3.0, 3.0), speed=st.floats(-4.0, 1.0), mass=st.floats(-1.0, 1.0), fullness=st.floats(1e-6, 1.0),
    sign=st.sampled_from([-1.0, 1.0]),
)  # fmt: skip
@example(force=2.0, speed=-9.0, mass=0.0, fullness=1.0, sign=1.0)
def test_valve_and_level_equal_the_formula_within_a_few_ulps(dtype, force, speed, mass, fullness, sign):
    f, v, m = (column(10.0**x, dtype) for x in (force, speed, mass))
    energy = column(3 * fullness, dtype)
    out = rate_tank(sign * f, v, energy, **LIMITS, inertia=m)
    p, a = f.item() * v.item(), f.item() ** 2 / m.item()
    spread = [(2.0, 0.01 * a), (energy.item() / 0.01, 0.005 * a)]
    valve = min(1.0, *(2 * limit / max(2e-6, p + math.sqrt(p * p + 4 * limit * c)) for limit, c in spread))
    ulp = torch.finfo(dtype).eps
    assert out.valve.item() == pytest.approx(valve, rel=32 * ulp)
    assert out.power.item() == pytest.approx(valve * p + valve**2 * 0.005 * a, rel=64 * ulp)
    assert out.energy.item() == pytest.approx(energy.item() - 0.01 * out.power.item(), abs=32 * ulp * energy.item())


@each_dtype
@LAWS
@given(effort=VECTOR, flow=VECTOR, fullness=FULLNESS)
def test_the_papers_law_is_the_limit_of_a_large_inertia_and_never_the_stricter_one(dtype, effort, flow, fullness):
    effort, flow = (torch.tensor(value, dtype=dtype) for value in (effort, flow))
    args = effort, flow, column(3 * fullness, dtype)
    paper = energy_tank(*args, **LIMITS).valve.item()
    heavy = rate_tank(*args, **LIMITS, inertia=torch.full((6,), 1e30, dtype=dtype)).valve.item()
    light = rate_tank(*args, **LIMITS, inertia=INERTIA.to(dtype)).valve.item()
    assert heavy == pytest.approx(paper, rel=1e-5, abs=1e-20)
    assert light <= heavy


@each_dtype
def test_a_matrix_of_inertia_bounds_what_it_accelerates(dtype):
    generator = torch.Generator().manual_seed(0)
    factor = torch.randn(5, 6, 6, generator=generator, dtype=dtype)
    inertia = factor @ factor.mT + torch.eye(6, dtype=dtype)
    effort, flow = (10 * torch.randn(5, 6, generator=generator, dtype=dtype) for _ in range(2))
    for given_inertia in (inertia, inertia[0]):
        out = rate_tank(effort, flow, torch.ones(5, 1, dtype=dtype), **LIMITS, inertia=given_inertia)
        held = (out.valve * effort).double()
        moved = flow.double() + 0.01 * torch.linalg.solve(given_inertia.double(), held.unsqueeze(-1)).squeeze(-1)
        power = torch.stack([(held * flow.double()).sum(-1).abs(), (held * moved).sum(-1).abs()])
        assert (power <= 2.0 * (1 + 1e-12)).all()
        assert power.max() > 1.0
    diagonal = rate_tank(effort, flow, torch.ones(5, 1, dtype=dtype), **LIMITS, inertia=INERTIA.to(dtype))
    matrix = rate_tank(effort, flow, torch.ones(5, 1, dtype=dtype), **LIMITS, inertia=INERTIA.to(dtype).diag())
    assert_close(diagonal, matrix, rtol=1e-5, atol=0.0)


def test_the_power_at_the_end_of_a_step_would_exceed_the_limit_behind_the_papers_law():
    effort, flow, energy = torch.tensor([50.0]), torch.zeros(1), torch.ones(1)
    inertia = torch.ones(1)
    ends = []
    for step in (
        energy_tank(effort, flow, energy, **LIMITS),
        rate_tank(effort, flow, energy, **LIMITS, inertia=inertia),
    ):
        held = step.valve * effort
        ends.append(float(held * (flow + 0.01 * held / inertia)))
    assert ends[0] == pytest.approx(25.0)
    assert 1.99 < ends[1] <= 2.0


@pytest.mark.parametrize("law", [rate_tank, impact_tank])
@pytest.mark.parametrize("shape", [(5,), (6, 5), (2, 1, 6)])
def test_an_inertia_of_another_shape_is_refused(law, shape):
    with pytest.raises(ValueError, match=r"inertia has shape .*; expected \(6,\) by axis, or a matrix \(6, 6\)"):
        law(torch.ones(2, 6), torch.ones(2, 6), torch.ones(2, 1), **LIMITS, inertia=torch.ones(shape))


@pytest.mark.parametrize("law", [rate_tank, impact_tank])
@pytest.mark.parametrize("inertia", [-torch.ones(6), -torch.eye(6), torch.zeros(6)])
def test_an_inertia_that_nothing_has_closes_the_valve(law, inertia):
    out = law(torch.ones(2, 6), torch.ones(2, 6), torch.ones(2, 1), **LIMITS, inertia=inertia)
    assert not out.valve.any()


@pytest.mark.parametrize("law", [rate_tank, impact_tank])
@each_dtype
def test_an_effort_whose_price_is_too_small_a_number_does_not_pass(law, dtype):
    effort, flow = torch.tensor([-1.0, 0.0], dtype=dtype), torch.zeros(2, dtype=dtype)
    level = column(1e-29 if dtype is torch.float32 else 1e-250, dtype)
    out = law(effort, flow, level, **LIMITS, inertia=torch.ones(2, dtype=dtype))
    assert not out.valve.any()
    assert torch.equal(out.energy, level)
    assert law(0 * effort, flow, column(1.0, dtype), **LIMITS, inertia=torch.ones(2, dtype=dtype)).valve.item() == 1.0


# -- impact ------------------------------------------------------------------------------------------------------------


def largest(effort, flow, inertia, stored=0.0):
    """Roots of ``effort . M^-1 effort`` and of the largest ``v . M v`` that contact may cause, in double precision."""
    effort, flow, inertia = effort.double(), flow.double(), inertia.double()
    s = (effort @ torch.linalg.solve(inertia, effort)).sqrt()
    return s, (flow @ inertia @ flow).clamp_min(2 * stored).sqrt()


@each_dtype
@settings(LAWS, max_examples=80)
@given(seed=st.integers(0, 2**31), scale=st.floats(-3.0, 3.0), fullness=st.floats(1e-6, 1.0), held=st.floats(0.0, 1.0))
def test_the_valve_of_impact_equals_the_formula(dtype, seed, scale, fullness, held):
    generator = torch.Generator().manual_seed(seed)
    effort, flow = (10**scale * torch.randn(2, 6, generator=generator, dtype=torch.float64)).to(dtype)
    energy, stored = column(3 * fullness, dtype), column(held, dtype)
    out = impact_tank(effort, flow, energy, **LIMITS, inertia=INERTIA.to(dtype), stored=stored)
    s, k = (float(x) for x in largest(effort, flow, INERTIA.to(dtype).diag(), held))
    p, rise = abs(float(effort.double() @ flow.double())), s**2
    bounds = [(2.0, s * k, 0.01 * rise), (min(2.0, energy.item() / 0.01), p, 0.005 * rise)]
    valve = min(1.0, *(2 * limit / max(2e-6, b + math.sqrt(b * b + 4 * limit * c)) for limit, b, c in bounds))
    doubt = 1e-5 if dtype is torch.float32 else 1e-12
    assert out.valve.item() == pytest.approx(valve, rel=doubt)
    assert out.power.item() == pytest.approx(valve * p + valve**2 * 0.005 * rise, rel=50 * doubt, abs=1e-12)


@each_dtype
@LAWS
@given(seed=st.integers(0, 2**31), scale=st.floats(-2.0, 4.0))
def test_no_velocity_that_passive_contact_may_cause_takes_more_than_the_limit(dtype, seed, scale):
    generator = torch.Generator().manual_seed(seed)
    factor = torch.randn(7, 7, generator=generator, dtype=torch.float64)
    inertia = factor @ factor.mT + 0.1 * torch.eye(7, dtype=torch.float64)
    effort, flow = (10**scale * torch.randn(7, generator=generator, dtype=torch.float64)).to(dtype), factor[0].to(dtype)
    out = impact_tank(effort, flow, column(1e9, dtype), **(LIMITS | {"e_max": 1e9}), inertia=inertia.to(dtype))
    held = (out.valve * effort).double()
    s, k = largest(held, flow, inertia.to(dtype))
    # the worst velocity of that norm, and a thousand others: what a collision in any direction may leave
    worst = torch.linalg.solve(inertia.to(dtype).double(), held)
    others = torch.randn(1000, 7, generator=generator, dtype=torch.float64)
    for velocity in (worst.unsqueeze(0), others):
        norm = torch.einsum("bi,ij,bj->b", velocity, inertia.to(dtype).double(), velocity).sqrt().unsqueeze(-1)
        power = (velocity / norm * (k + 0.01 * s)) @ held
        assert (power.abs() <= 2.0 * (1 + 1e-6)).all()
    assert (worst / norm_of(worst, inertia) * (k + 0.01 * s)) @ held > 1.999 or out.valve == 1


def norm_of(velocity, inertia):
    return (velocity @ inertia @ velocity).sqrt()


@each_dtype
@LAWS
@given(effort=VECTOR, flow=VECTOR, fullness=FULLNESS)
def test_impact_is_never_less_strict_than_rate(dtype, effort, flow, fullness):
    effort, flow = (torch.tensor(value, dtype=dtype) for value in (effort, flow))
    args = effort, flow, column(3 * fullness, dtype)
    laws = [law(*args, **LIMITS, inertia=INERTIA.to(dtype)).valve.item() for law in (rate_tank, impact_tank)]
    assert laws[1] <= laws[0] * (1 + 1e-5)


def test_an_effort_that_brakes_is_limited_since_an_impact_would_make_it_drive():
    effort, flow = torch.tensor([-50.0]), torch.tensor([0.5])
    out = impact_tank(effort, flow, torch.ones(1), **LIMITS, inertia=torch.tensor([4.0]))
    reversed_power = out.valve * effort * -(0.5 + 0.01 * out.valve * 50 / 4)
    assert reversed_power.item() == pytest.approx(2.0, rel=1e-4)
    assert rate_tank(effort, flow, torch.ones(1), **LIMITS, inertia=torch.tensor([4.0])).valve <= 2 / 25


# -- the energy that contact may hold ----------------------------------------------------------------------------------


@each_dtype
def test_contact_holds_the_largest_recent_motion_and_forgets_it(dtype):
    inertia, fast, still = torch.tensor([2.0, 4.0], dtype=dtype), *torch.tensor([[1.0, 0.5], [0.0, 0.0]], dtype=dtype)
    held = recent_motion(fast, inertia, None, dt=0.01)
    assert_close(held, column(1.5, dtype))
    for _ in range(10):
        held = recent_motion(still, inertia, held, dt=0.01)
    assert_close(held, column(1.5 * math.exp(-1.0), dtype))
    assert_close(recent_motion(fast, inertia.diag(), held, dt=0.01), column(1.5, dtype))


def test_what_contact_holds_counts_like_motion():
    effort, still = torch.tensor([20.0]), torch.zeros(1)
    args = {"inertia": torch.tensor([4.0]), **LIMITS}
    after_impact = impact_tank(effort, still, torch.ones(1), stored=torch.tensor([0.5]), **args)
    moving = impact_tank(effort, torch.tensor([0.5]), torch.ones(1), **args)
    assert_close(after_impact.valve, moving.valve)
    assert impact_tank(effort, still, torch.ones(1), **args).valve > 2 * moving.valve
