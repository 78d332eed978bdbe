"""The laws of the tank, evaluated in exact fractions of the stored numbers."""

import math
from fractions import Fraction

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.testing import assert_close

from ppt_rl.functional import energy_tank, parallel_tank, passive_tank
from ppt_rl.functional.tank_laws import beside, dissipative_part
from tests.functional.exact_tanks import LAW_CASES, check_result, check_step, dot, exact, fractions

F32, F64 = torch.float32, torch.float64
each_dtype = pytest.mark.parametrize("dtype", [F32, F64], ids=["float32", "float64"])
each_law = pytest.mark.parametrize("name", sorted(LAW_CASES))
LAWS = settings(max_examples=40, deadline=None, derandomize=True)
LIMITS = {"p_max": 2.0, "e_max": 3.0, "dt": 0.01}
INERTIA = torch.tensor([1.58, 1.87, 1.21, 0.91, 0.127, 0.135])

# Components of efforts and velocities whose products neither overflow nor underflow, in any mixture of magnitudes.
COMPONENT = st.just(0.0) | st.tuples(st.sampled_from([-1.0, 1.0]), st.floats(-6.0, 9.0)).map(
    lambda x: x[0] * 10 ** x[1]
)
VECTOR = st.lists(COMPONENT, min_size=6, max_size=6)
FULLNESS = st.just(0.0) | st.just(1.0) | st.floats(0.0, 1.0) | st.floats(-30.0, 0.0).map(lambda e: 10.0**e)
P_MAX = st.floats(-3.0, 4.0).map(lambda e: 10.0**e)
E_MAX = st.floats(-3.0, 4.0).map(lambda e: 10.0**e)
DT = st.floats(-4.0, 0.0).map(lambda e: 10.0**e)


def column(value: float, dtype: torch.dtype) -> Tensor:
    return torch.tensor([value], dtype=dtype)


# -- the invariants, exactly -------------------------------------------------------------------------------------------


@each_law
@each_dtype
@LAWS
@given(effort=VECTOR, flow=VECTOR, damping=VECTOR, fullness=FULLNESS, p_max=P_MAX, e_max=E_MAX, dt=DT)
def test_a_step_keeps_the_invariants_of_its_law_exactly(name, dtype, effort, flow, damping, fullness, p_max, e_max, dt):
    effort, flow, damping = (torch.tensor(value, dtype=dtype) for value in (effort, flow, damping))
    energy = column(fullness * e_max, dtype)
    check_step(name, effort, flow, damping, energy, INERTIA.to(dtype), p_max=p_max, e_max=e_max, dt=dt)


@pytest.mark.slow
@each_law
@each_dtype
@settings(LAWS, max_examples=100_000)
@given(effort=VECTOR, flow=VECTOR, damping=VECTOR, fullness=FULLNESS, p_max=P_MAX, e_max=E_MAX, dt=DT)
def test_a_hundred_thousand_generated_cases_keep_the_invariants_exactly(
    name, dtype, effort, flow, damping, fullness, p_max, e_max, dt
):
    effort, flow, damping = (torch.tensor(value, dtype=dtype) for value in (effort, flow, damping))
    energy = column(fullness * e_max, dtype)
    check_step(name, effort, flow, damping, energy, INERTIA.to(dtype), p_max=p_max, e_max=e_max, dt=dt)


@each_law
@each_dtype
@LAWS
@given(seed=st.integers(0, 2**31), exponent=st.floats(0.0, 12.0), tilt=st.floats(-1e-6, 1e-6))
def test_efforts_at_right_angles_to_the_motion_keep_the_invariants_where_large_terms_cancel(
    name, dtype, seed, exponent, tilt
):
    generator = torch.Generator().manual_seed(seed)
    effort, flow, damping = torch.randn(3, 6, generator=generator, dtype=F64)
    effort = 10**exponent * (effort - flow * (effort @ flow) / (flow @ flow) + tilt)
    damping = -(10**exponent) * flow if seed % 2 else 10**exponent * damping
    effort, flow, damping = (value.to(dtype) for value in (effort, flow, damping))
    check_step(name, effort, flow, damping, column(1.0, dtype), INERTIA.to(dtype), **LIMITS)


@each_law
@each_dtype
@LAWS
@given(seed=st.integers(0, 2**31), first=FULLNESS, scale=st.floats(-3.0, 3.0))
def test_over_an_episode_the_net_energy_delivered_is_at_most_what_the_tank_has_lost(name, dtype, seed, first, scale):
    generator = torch.Generator().manual_seed(seed)
    energy, total = column(3 * first, dtype), Fraction(0)
    start = exact(energy)
    for _ in range(12):
        effort, flow, damping = torch.randn(3, 6, generator=generator, dtype=F64) * 10**scale
        effort, flow, damping = (value.to(dtype) for value in (effort, flow, damping))
        energy, delivered = check_step(name, effort, flow, damping, energy, INERTIA.to(dtype), **LIMITS)
        total += delivered
    assert total <= start - exact(energy)


@each_law
@each_dtype
def test_batched_rows_equal_single_calls(name, dtype):
    law = LAW_CASES[name].law
    generator = torch.Generator().manual_seed(0)
    effort, flow = (3 * torch.randn(2, 3, 6, generator=generator, dtype=dtype) for _ in range(2))
    energy = 0.1 * torch.rand(2, 3, 1, generator=generator, dtype=dtype)
    read = LAW_CASES[name].read(-flow, INERTIA.to(dtype))
    out = law(effort, flow, energy, **LIMITS, **read)
    assert all(part.shape == (2, 3, 1) and part.dtype == dtype for part in out)
    for i in range(2):
        row = {key: value[i] if key == "damping" else value for key, value in read.items()}
        assert_close(law(effort[i], flow[i], energy[i], **LIMITS, **row), type(out)(*(part[i] for part in out)))


@each_law
@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize("where", ["effort", "flow", "energy"])
def test_a_non_finite_input_raises(name, bad, where):
    inputs = {"effort": torch.ones(4, 6), "flow": torch.ones(4, 6), "energy": torch.ones(4, 1)}
    read = LAW_CASES[name].read(-torch.ones(4, 6), INERTIA)
    inputs[where][2, 0] = bad
    with pytest.raises(ValueError, match=r"(effort|flow|tank_energy) holds \d+ NaN or infinite entries of"):
        LAW_CASES[name].law(**inputs, **LIMITS, **read)


@each_law
@each_dtype
def test_a_power_that_overflows_closes_the_valve_and_leaves_the_level(name, dtype):
    huge = torch.full((1, 6), torch.finfo(dtype).max, dtype=dtype)
    read = LAW_CASES[name].read(-huge, INERTIA.to(dtype))
    for flow in (huge, -huge):
        out = LAW_CASES[name].law(huge, flow, torch.ones(1, 1, dtype=dtype), **LIMITS, **read)
        assert (out.valve.item(), out.energy.item(), out.power.item()) == (0.0, 1.0, 0.0)


@pytest.mark.slow
@each_law
@each_dtype
def test_a_hundred_thousand_hostile_steps_keep_the_invariants_exactly(name, dtype):
    generator, rows = torch.Generator().manual_seed(1), 100_000
    effort, flow, damping = torch.randn(3, rows, 6, generator=generator, dtype=F64)
    scales = 10 ** torch.empty(3, rows, 6, dtype=F64).uniform_(-4.0, 8.0, generator=generator)
    kind = torch.randint(4, (rows, 1), generator=generator)
    at_right_angles = effort - flow * (effort * flow).sum(-1, keepdim=True) / flow.square().sum(-1, keepdim=True)
    effort = torch.where(kind < 2, effort * scales[0], at_right_angles * scales[0][:, :1])
    flow = torch.where(kind == 0, flow * scales[1], flow)
    damping = torch.where(kind % 2 == 0, -scales[2] * flow, damping * scales[2])
    energy = 3 * torch.rand(rows, 1, generator=generator, dtype=F64) ** 8
    effort, flow, damping, energy = (value.to(dtype) for value in (effort, flow, damping, energy))
    case, inertia = LAW_CASES[name], INERTIA.to(dtype)
    out = case.law(effort, flow, energy, **LIMITS, **case.read(damping, inertia))
    assert (out.valve < 1).any()
    for i in range(rows):
        row = type(out)(*(part[i] for part in out))
        check_result(name, row, effort[i], flow[i], damping[i], energy[i], inertia, **LIMITS)


# -- limits that are given per step ------------------------------------------------------------------------------------


@each_law
@each_dtype
@LAWS
@given(effort=VECTOR, flow=VECTOR, damping=VECTOR, p_max=P_MAX | st.just(0.0), e_max=E_MAX | st.just(0.0))
def test_limits_given_as_tensors_keep_the_invariants_and_equal_those_given_as_numbers(
    name, dtype, effort, flow, damping, p_max, e_max
):
    effort, flow, damping = (torch.tensor(value, dtype=dtype) for value in (effort, flow, damping))
    p_limit, e_limit = column(p_max, dtype), column(e_max, dtype)
    args = (name, effort, flow, damping, column(1.0, dtype), INERTIA.to(dtype))
    level, _ = check_step(*args, p_max=p_limit, e_max=e_limit, dt=0.01)
    if p_max and e_max >= 1.0:
        number, _ = check_step(*args, p_max=p_limit.item(), e_max=e_limit.item(), dt=0.01)
        assert_close(level, number, rtol=0.0, atol=0.0)


@each_law
def test_limits_are_those_of_each_row(name):
    effort, flow, energy = torch.ones(3, 6), torch.ones(3, 6), torch.ones(3, 1)
    read = LAW_CASES[name].read(-torch.ones(3, 6), INERTIA)
    p_max = torch.tensor([[0.0], [-1.0], [1e6]])
    out = LAW_CASES[name].law(effort, flow, energy, **(LIMITS | {"p_max": p_max}), **read)
    assert out.valve.flatten()[:2].tolist() == [0.0, 0.0]
    assert out.valve[2] > 0
    capacity = torch.tensor([[0.0], [0.5], [9.0]])
    read = LAW_CASES[name].read(torch.zeros(3, 6), INERTIA)
    out = LAW_CASES[name].law(0 * effort, flow, energy, **(LIMITS | {"e_max": capacity}), **read)
    assert out.energy.flatten().tolist() == [0.0, 0.5, 1.0]


@each_law
@pytest.mark.parametrize("which", ["p_max", "e_max"])
def test_limits_that_are_nan_or_of_another_shape_are_refused(name, which):
    args, read = (
        (torch.ones(3, 6), torch.ones(3, 6), torch.ones(3, 1)),
        LAW_CASES[name].read(-torch.ones(3, 6), INERTIA),
    )
    with pytest.raises(ValueError, match=rf"{which} holds 3 NaN"):
        LAW_CASES[name].law(*args, **(LIMITS | {which: torch.full((3, 1), math.nan)}), **read)
    with pytest.raises(
        ValueError, match=rf"{which} has shape \(3,\); expected a number, or one for each level: \(3, 1\)"
    ):
        LAW_CASES[name].law(*args, **(LIMITS | {which: torch.ones(3)}), **read)


# -- passive -----------------------------------------------------------------------------------------------------------


@each_dtype
@LAWS
@given(p=st.floats(1e-3, 1e6), level=st.floats(0.0, 3.0))
def test_braking_passes_an_empty_or_full_tank_and_refills_it(dtype, p, level):
    out = passive_tank(column(-p, dtype), column(1.0, dtype), column(level, dtype), **LIMITS)
    assert out.valve.item() == 1.0
    assert out.energy.item() == pytest.approx(min(3.0, level + p * 0.01), rel=1e-5)
    assert out.energy.item() >= column(level, dtype).item() or level > 3.0


@each_dtype
@LAWS
@given(p=st.floats(0.0, 1e6), level=FULLNESS)
def test_pushing_is_charged_as_by_the_papers_law(dtype, p, level):
    args = column(p, dtype), column(1.0, dtype), column(3 * level, dtype)
    assert_close(passive_tank(*args, **LIMITS), energy_tank(*args, **LIMITS), rtol=0.0, atol=0.0)


def test_an_effort_without_power_is_stopped_by_an_empty_tank():
    out = passive_tank(torch.ones(1), torch.zeros(1), torch.zeros(1), **LIMITS)
    assert (out.valve.item(), out.energy.item()) == (0.0, 0.0)


# -- parallel ----------------------------------------------------------------------------------------------------------


@each_dtype
def test_an_empty_tank_leaves_the_damping_alone(dtype):
    flow = torch.tensor([0.5, -0.2], dtype=dtype)
    effort, damping = torch.tensor([30.0, 10.0], dtype=dtype), torch.tensor([-5.0, 2.0], dtype=dtype)
    out = parallel_tank(effort, flow, column(0.0, dtype), **LIMITS, damping=damping)
    assert (out.valve.item(), out.energy.item()) == (0.0, 0.0)
    assert torch.equal(beside(out.valve, effort, damping), damping)


@each_dtype
def test_a_worked_example_scales_the_active_part(dtype):
    args = [torch.tensor(value, dtype=dtype) for value in ([6.0, 0.0], [0.5, 0.0], [1.0])]
    damping = torch.tensor([-2.0, 0.0], dtype=dtype)  # the active part is 8 N at 0.5 m/s
    out = parallel_tank(*args, **LIMITS, damping=damping)
    assert_close(out.valve, column(0.5, dtype), rtol=1e-5, atol=0.0)
    assert_close(out.energy, column(0.98, dtype), rtol=1e-5, atol=0.0)
    assert_close(beside(out.valve, args[0], damping), torch.tensor([2.0, 0.0], dtype=dtype), rtol=1e-5, atol=1e-5)


@each_dtype
def test_a_damping_that_pushes_counts_as_active(dtype):
    args = [torch.tensor(value, dtype=dtype) for value in ([6.0, 0.0], [0.5, 0.0], [1.0])]
    pushing = torch.tensor([2.0, 0.0], dtype=dtype)
    assert not dissipative_part(pushing, args[1]).any()
    assert_close(parallel_tank(*args, **LIMITS, damping=pushing), energy_tank(*args, **LIMITS), rtol=1e-5, atol=0.0)


@each_dtype
@LAWS
@given(effort=VECTOR, damping=VECTOR)
def test_an_open_valve_leaves_the_effort_exactly_as_it_is(dtype, effort, damping):
    effort, damping = torch.tensor(effort, dtype=dtype), torch.tensor(damping, dtype=dtype)
    assert torch.equal(beside(column(1.0, dtype), effort, damping), effort)


def test_a_damping_of_another_space_is_refused():
    with pytest.raises(ValueError, match=r"damping has shape \(2, 6\).*expected that of the velocity.*\(2, 7\)"):
        parallel_tank(torch.ones(2, 7), torch.ones(2, 7), torch.ones(2, 1), **LIMITS, damping=torch.ones(2, 6))


# -- the oracle --------------------------------------------------------------------------------------------------------


def test_the_exact_evaluation_sees_an_error_in_the_last_digits():
    a, b = torch.tensor([1e8, 1.0, -1e8]), torch.tensor([1.0, 1.0, 1.0])
    assert dot(fractions(a), fractions(b)) == 1
