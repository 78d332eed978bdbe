import math
from fractions import Fraction

import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.testing import assert_close

from ppt_rl.functional import EnergyTankStep, energy_tank

F32, F64 = torch.float32, torch.float64
each_dtype = pytest.mark.parametrize("dtype", [F32, F64], ids=["float32", "float64"])
LAWS = settings(max_examples=250, deadline=None, derandomize=True)
EPS = 1e-6


def column(value: float | list[float], dtype: torch.dtype) -> Tensor:
    return torch.tensor(value, dtype=dtype).reshape(-1, 1)


def exact(value: Tensor) -> Fraction:
    return Fraction(value.item())


def rounded(value: float, dtype: torch.dtype) -> float:
    return torch.tensor(value, dtype=dtype).item()


def step(p: float, energy: float, dtype: torch.dtype, *, p_max: float = 2.0, e_max: float = 3.0, dt: float = 0.01):
    return energy_tank(
        column(p, dtype), column(1.0, dtype), column(energy, dtype), p_max=p_max, e_max=e_max, dt=dt, eps=EPS
    )


# Powers and levels from zero and the smallest subnormal to the largest finite number of the precision.
POWERS = {
    F32: st.floats(-45.0, 38.0).map(lambda e: 10.0**e) | st.floats(0.0, rounded(3.4e38, F32), width=32),
    F64: st.floats(-323.0, 308.0).map(lambda e: 10.0**e) | st.floats(0.0, 1.7e308),
}
LEVELS = st.just(0.0) | st.just(1.0) | st.floats(0.0, 1.0) | st.floats(-330.0, 0.0).map(lambda e: 10.0**e)
P_MAX = st.floats(-6.0, 6.0).map(lambda e: 10.0**e)
E_MAX = st.floats(-3.0, 6.0).map(lambda e: 10.0**e)
DT = st.floats(-4.0, 1.0).map(lambda e: 10.0**e)


@each_dtype
@LAWS
@given(data=st.data(), fullness=LEVELS, p_max=P_MAX, e_max=E_MAX, dt=DT)
def test_valve_power_and_level_stay_within_their_limits_exactly(dtype, data, fullness, p_max, e_max, dt):
    p = rounded(data.draw(POWERS[dtype]), dtype)
    e_max = rounded(e_max, dtype)
    energy = rounded(fullness * e_max, dtype)
    out = step(p, energy, dtype, p_max=p_max, e_max=e_max, dt=dt)
    assert 0 <= exact(out.valve) <= 1
    assert exact(out.valve) * Fraction(p) <= Fraction(p_max)
    assert exact(out.power) <= Fraction(p_max)
    assert 0 <= exact(out.energy) <= Fraction(e_max)


@each_dtype
@LAWS
@given(data=st.data(), fullness=LEVELS, p_max=P_MAX, e_max=E_MAX, dt=DT)
def test_the_level_falls_by_at_least_the_energy_let_through(dtype, data, fullness, p_max, e_max, dt):
    p = rounded(data.draw(POWERS[dtype]), dtype)
    energy = rounded(fullness * rounded(e_max, dtype), dtype)
    out = step(p, energy, dtype, p_max=p_max, e_max=e_max, dt=dt)
    assert exact(out.energy) + exact(out.valve) * Fraction(p) * Fraction(dt) <= Fraction(energy)


@each_dtype
@LAWS
@given(data=st.data(), fullness=LEVELS, p_max=P_MAX, e_max=E_MAX, dt=DT)
def test_a_sequence_of_steps_never_lets_through_more_than_the_first_level(dtype, data, fullness, p_max, e_max, dt):
    powers = data.draw(st.lists(POWERS[dtype], min_size=1, max_size=15))
    first = energy = rounded(fullness * rounded(e_max, dtype), dtype)
    total = Fraction(0)
    for p in powers:
        out = step(p, energy, dtype, p_max=p_max, e_max=e_max, dt=dt)
        total += exact(out.valve) * Fraction(rounded(p, dtype)) * Fraction(dt)
        energy = out.energy.item()
    assert total <= Fraction(first)


@each_dtype
def test_long_random_episodes_empty_the_tank_and_spend_no_more_than_the_first_level(dtype):
    generator = torch.Generator().manual_seed(0)
    effort = 20 * torch.randn(2000, 64, 6, generator=generator, dtype=dtype)
    flow = torch.randn(2000, 64, 6, generator=generator, dtype=dtype)
    first = energy = 3 * torch.rand(64, 1, generator=generator, dtype=dtype)
    spent = []
    for f, v in zip(effort, flow, strict=True):
        out = energy_tank(f, v, energy, p_max=2.0, e_max=3.0, dt=0.01)
        p = (f * v).sum(-1, keepdim=True).abs()
        spent.append(out.valve.double() * p.double() * 0.01)
        energy = out.energy
    totals = torch.cat(spent, -1)
    for row, start in zip(totals, first, strict=True):
        assert math.fsum(row.tolist()) <= start.item()
    assert_close(totals.sum(-1, keepdim=True), first.double(), rtol=1e-2, atol=1e-6)


@each_dtype
@LAWS
@given(
    effort=st.lists(st.floats(-(2.0**50), 2.0**50, width=32), min_size=6, max_size=6),
    flow=st.lists(st.floats(-(2.0**50), 2.0**50, width=32), min_size=6, max_size=6),
    fullness=LEVELS,
)
def test_the_limits_hold_for_the_power_of_any_wrench_and_twist(dtype, effort, flow, fullness):
    f, v = torch.tensor(effort, dtype=dtype), torch.tensor(flow, dtype=dtype)
    energy = column(3 * fullness, dtype)[0]
    out = energy_tank(f, v, energy, p_max=2.0, e_max=3.0, dt=0.01)
    let_through = exact(out.valve) * abs(exact((f * v).sum()))
    assert let_through <= 2
    assert let_through * Fraction(0.01) + exact(out.energy) <= exact(energy)


@each_dtype
@LAWS
@given(p=st.floats(0.0, 1.9), energy=st.floats(0.1, 3.0))
def test_the_valve_is_exactly_one_far_from_the_limits(dtype, p, energy):
    assert step(p, energy, dtype).valve.item() == 1.0


@each_dtype
@LAWS
@given(data=st.data(), energy=st.floats(0.0, 3.0), p_max=P_MAX, more=st.floats(1.0, 1e3))
def test_a_larger_power_limit_never_closes_the_valve(dtype, data, energy, p_max, more):
    p = data.draw(POWERS[dtype])
    tight = step(p, energy, dtype, p_max=p_max)
    loose = step(p, energy, dtype, p_max=p_max * more)
    assert loose.valve.item() >= tight.valve.item()
    assert loose.energy.item() <= tight.energy.item()


@each_dtype
@LAWS
@given(data=st.data(), less=st.floats(0.0, 1.0), energy=st.floats(0.0, 3.0))
def test_a_fuller_tank_never_closes_the_valve(dtype, data, less, energy):
    p = data.draw(POWERS[dtype])
    assert step(p, energy, dtype).valve.item() >= step(p, less * energy, dtype).valve.item()


@each_dtype
@LAWS
@given(energy=st.floats(0.0, 3.0))
def test_zero_power_leaves_the_level_exactly_as_it_is(dtype, energy):
    assert step(0.0, energy, dtype).energy.item() == rounded(energy, dtype)


@each_dtype
def test_an_empty_tank_stays_empty_with_its_valve_closed(dtype):
    out = step(5.0, 0.0, dtype)
    assert (out.valve.item(), out.energy.item(), out.power.item()) == (0.0, 0.0, 0.0)


@each_dtype
@settings(LAWS, max_examples=500)
@given(
    exponent=st.floats(-9.0, 9.0),
    fullness=st.floats(1e-6, 1.0),
    p_max=st.floats(0.01, 100.0),
    e_max=st.floats(0.1, 100.0),
    dt=st.floats(1e-3, 0.1),
)
@example(exponent=-7.0, fullness=1.0, p_max=2.0, e_max=3.0, dt=0.01)
def test_valve_and_level_equal_the_papers_formula_within_a_few_ulps(dtype, exponent, fullness, p_max, e_max, dt):
    p, energy = rounded(10.0**exponent, dtype), rounded(fullness * e_max, dtype)
    out = step(p, energy, dtype, p_max=p_max, e_max=e_max, dt=dt)
    divisor = max(EPS, p)
    valve = min(1.0, p_max / divisor, energy / (dt * divisor))
    level = min(max(energy - valve * p * dt, 0.0), e_max)
    ulp = torch.finfo(dtype).eps
    assert out.valve.item() == pytest.approx(valve, rel=8 * ulp, abs=0.0)
    assert out.power.item() == pytest.approx(valve * p, rel=8 * ulp, abs=0.0)
    assert out.energy.item() == pytest.approx(level, rel=0.0, abs=16 * ulp * energy)


@each_dtype
def test_a_worked_example_limited_by_power(dtype):
    out = energy_tank(
        torch.tensor([10.0, 0.0, -5.0], dtype=dtype),
        torch.tensor([0.5, 3.0, 0.2], dtype=dtype),
        torch.tensor([1.0], dtype=dtype),
        p_max=2.0,
        e_max=3.0,
        dt=0.01,
    )
    expected = EnergyTankStep(*(torch.tensor([x], dtype=dtype) for x in (0.5, 0.98, 2.0)))
    assert_close(out, expected, rtol=1e-6, atol=0.0)


@each_dtype
def test_a_worked_example_limited_by_energy(dtype):
    out = step(4.0, 0.01, dtype, p_max=10.0)
    assert_close(out.valve, column(0.25, dtype), rtol=1e-6, atol=0.0)
    assert_close(out.power, column(1.0, dtype), rtol=1e-6, atol=0.0)
    assert_close(out.energy, column(0.0, dtype), rtol=0.0, atol=1e-8)


def test_braking_is_charged_like_pushing():
    push, brake = step(3.0, 1.0, F64), step(-3.0, 1.0, F64)
    assert_close(push, brake, rtol=0.0, atol=0.0)


def test_a_level_above_the_capacity_is_clipped_to_it():
    assert step(0.0, 5.0, F64, e_max=3.0).energy.item() == 3.0


@each_dtype
@pytest.mark.parametrize("batch", [(), (3,), (2, 3), (0,)])
def test_batched_rows_equal_single_calls(dtype, batch):
    generator = torch.Generator().manual_seed(0)
    effort, flow = (3 * torch.randn(*batch, 6, generator=generator, dtype=dtype) for _ in range(2))
    energy = 0.1 * torch.rand(*batch, 1, generator=generator, dtype=dtype)
    out = energy_tank(effort, flow, energy, p_max=2.0, e_max=3.0, dt=0.01)
    assert all(part.shape == (*batch, 1) and part.dtype == dtype for part in out)
    rows = zip(effort.reshape(-1, 6), flow.reshape(-1, 6), energy.reshape(-1, 1), strict=True)
    single = [energy_tank(*row, p_max=2.0, e_max=3.0, dt=0.01) for row in rows]
    for part, *parts in zip(out, *single, strict=True):
        assert_close(part.reshape(-1, 1), torch.stack(parts) if parts else part.reshape(-1, 1))


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("where", ["effort", "flow", "energy"])
def test_a_non_finite_input_raises(bad, where):
    inputs = {"effort": torch.ones(4, 6), "flow": torch.ones(4, 6), "energy": torch.ones(4, 1)}
    inputs[where][2, 0] = bad
    with pytest.raises(ValueError, match=r"(effort|flow|tank_energy) holds 1 NaN or infinite entries of"):
        energy_tank(**inputs, p_max=2.0, e_max=3.0, dt=0.01)


@each_dtype
def test_a_power_that_overflows_closes_the_valve_and_leaves_the_level(dtype):
    huge = torch.full((1, 2), torch.finfo(dtype).max, dtype=dtype)
    for flow in (huge, huge * torch.tensor([1.0, -1.0], dtype=dtype)):
        out = energy_tank(huge, flow, torch.ones(1, 1, dtype=dtype), p_max=2.0, e_max=3.0, dt=0.01)
        assert (out.valve.item(), out.energy.item(), out.power.item()) == (0.0, 1.0, 0.0)


def let_through(valve: Tensor, effort: Tensor, flow: Tensor) -> Fraction:
    """Exact power of what is executed: the stored product of valve and effort, on the stored flow."""
    executed = valve.to(effort.dtype) * effort
    return abs(sum((exact(f) * exact(v) for f, v in zip(executed, flow, strict=True)), Fraction(0)))


@pytest.mark.parametrize(("effort_dtype", "flow_dtype"), [(F32, F32), (F64, F64), (F32, F64), (F64, F32)], ids=str)
@settings(LAWS, max_examples=400)
@given(
    data=st.data(),
    exponents=st.lists(st.floats(-3.0, 30.0), min_size=6, max_size=6),
    tilt=st.floats(-1e-6, 1e-6),
)
def test_of_large_terms_that_cancel_no_more_than_the_limit_is_executed(effort_dtype, flow_dtype, data, exponents, tilt):
    signs = torch.tensor(data.draw(st.lists(st.sampled_from([-1.0, 1.0]), min_size=6, max_size=6)), dtype=F64)
    effort = signs * 10.0 ** torch.tensor(exponents, dtype=F64)
    flow = torch.ones(6, dtype=F64)
    flow = (flow - effort * (effort @ flow) / (effort @ effort) + tilt).to(flow_dtype)  # at right angles, or nearly
    effort = effort.to(effort_dtype)
    out = energy_tank(effort, flow, torch.ones(1, dtype=effort_dtype), p_max=2.0, e_max=3.0, dt=0.01)
    power = let_through(out.valve, effort, flow)
    assert power <= 2
    assert power * Fraction(0.01) + exact(out.energy) <= 1


def test_without_a_bound_on_rounding_the_cancellation_would_hide_hundreds_of_watts():
    generator = torch.Generator().manual_seed(0)
    effort = 1e10 * torch.randn(1000, 6, generator=generator)
    flow = torch.randn(1000, 6, generator=generator)
    effort = effort - flow * (effort * flow).sum(-1, keepdim=True) / flow.square().sum(-1, keepdim=True)
    stored = (effort * flow).sum(-1, keepdim=True).abs()
    naive = 2.0 / stored.clamp_min(2.0) * effort
    assert (naive.double() * flow.double()).sum(-1).abs().max() > 100.0
    valve = energy_tank(effort, flow, torch.ones(1000, 1), p_max=2.0, e_max=3.0, dt=0.01).valve
    assert ((valve * effort).double() * flow.double()).sum(-1).abs().max() <= 2.0


def test_an_effort_of_less_precision_than_the_flow_is_handed_back_the_precision_of_the_level():
    out = energy_tank(torch.ones(2, 3), torch.ones(2, 3, dtype=F64), torch.ones(2, 1), p_max=2.0, e_max=3.0, dt=0.01)
    assert {part.dtype for part in out} == {F32}
