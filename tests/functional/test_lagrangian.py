from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.testing import assert_close

from ppt_rl.functional import PIDGains, begin_multiplier, penalised, pid_multiplier
from tests.sampling import normal

F64 = torch.float64
LAWS = settings(max_examples=100, deadline=None, derandomize=True)
GAINS = st.builds(
    PIDGains,
    proportional=st.floats(0.0, 5.0), integral=st.floats(0.0, 2.0), derivative=st.floats(0.0, 5.0),
    smoothing=st.floats(0.0, 0.99), max_multiplier=st.floats(0.1, 20.0),
)  # fmt: skip
COSTS = st.lists(st.floats(0.0, 50.0), min_size=1, max_size=12)


def run(costs, limit, gains, initial=0.0):
    """States after each of some costs."""
    states = [begin_multiplier(torch.tensor(initial, dtype=F64))]
    for cost in costs:
        states.append(pid_multiplier(states[-1], torch.tensor(cost, dtype=F64), limit, gains))
    return states[1:]


def multipliers(*args, **kwargs):
    return [float(state.multiplier) for state in run(*args, **kwargs)]


@pytest.mark.parametrize("cost", [0.4, 1.0, 3.5])
def test_a_steady_cost_gives_a_proportional_part_and_a_ramp(cost):
    gains = PIDGains(proportional=0.5, integral=0.1, derivative=9.0, max_multiplier=1e6)
    expected = [max(0.0, 0.5 * (cost - 1.0) + max(0.0, 2.0 + 0.1 * k * (cost - 1.0))) for k in range(1, 60)]
    assert multipliers([cost] * 59, 1.0, gains, initial=2.0) == pytest.approx(expected, abs=1e-12)


@LAWS
@given(costs=COSTS, limit=st.floats(0.0, 20.0), gains=GAINS, share=st.floats(0.0, 1.0))
def test_the_law_is_that_of_a_pid_controller_with_a_bounded_integral(costs, limit, gains, share):
    initial = share * gains.max_multiplier
    integral, smoothed, expected = initial, None, []
    for cost in costs:
        last = cost if smoothed is None else smoothed
        smoothed = gains.smoothing * last + (1 - gains.smoothing) * cost
        integral = min(max(integral + gains.integral * (cost - limit), 0.0), gains.max_multiplier)
        total = gains.proportional * (smoothed - limit) + integral + gains.derivative * max(0.0, smoothed - last)
        expected.append(min(max(total, 0.0), gains.max_multiplier))
    found = multipliers(costs, limit, gains, initial)
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert all(0.0 <= value <= gains.max_multiplier for value in found)


def test_the_integral_does_not_wind_up_above_its_range():
    gains = PIDGains(proportional=0.0, integral=0.5, max_multiplier=3.0)
    *_, last, after = run([10.0] * 100 + [0.0], 1.0, gains)
    assert float(last.integral) == 3.0
    assert float(after.multiplier) == 2.5  # it falls with the first cost below the limit


def test_the_integral_does_not_wind_up_below_zero():
    gains = PIDGains(proportional=0.0, integral=0.5)
    assert multipliers([0.0] * 100 + [2.0], 1.0, gains)[-2:] == [0.0, 0.5]


def test_only_a_rising_cost_counts_in_the_derivative():
    gains = PIDGains(proportional=0.0, integral=0.0, derivative=2.0)
    assert multipliers([5.0, 8.0, 4.0, 4.5], 100.0, gains) == [0.0, 6.0, 0.0, 1.0]


def test_smoothing_begins_with_the_first_cost():
    states = run([4.0, 8.0], 0.0, PIDGains(smoothing=0.75))
    assert [float(state.cost) for state in states] == [4.0, 5.0]


def test_without_gains_the_multiplier_stays():
    gains = PIDGains(proportional=0.0, integral=0.0)
    assert multipliers([9.0, 0.0, 3.0], 1.0, gains, initial=0.7) == [0.7] * 3


def test_every_row_has_a_controller_of_its_own():
    costs, gains = 5.0 * normal(4, 3).abs(), PIDGains(derivative=0.5, smoothing=0.5)
    state = begin_multiplier(torch.zeros(3, dtype=F64))
    for cost in costs:
        state = pid_multiplier(state, cost, 2.0, gains)
    expected = [multipliers(column.tolist(), 2.0, gains)[-1] for column in costs.T]
    assert_close(state.multiplier, torch.tensor(expected, dtype=F64))


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_cost_that_is_not_finite_never_reaches_the_controller(bad):
    with pytest.raises(ValueError, match=r"cost .*(NaN|infin)"):
        run([bad], 1.0, PIDGains())


def test_a_multiplier_of_zero_penalises_nothing_to_the_bit():
    value, cost = normal(50, 1).float(), normal(50, 1, seed=1).float()
    assert torch.equal(penalised(value, cost, torch.zeros((), dtype=F64)), value)


def test_a_growing_multiplier_turns_the_reward_into_the_negative_cost():
    value, cost = normal(50, 1), normal(50, 1, seed=1)
    assert_close(penalised(value, cost, torch.tensor(1.0)), (value - cost) / 2)
    assert_close(penalised(value, cost, torch.tensor(1e9)), -cost, rtol=0, atol=1e-7)


def test_the_gradient_points_away_from_the_cost():
    cost = torch.ones(3, dtype=F64, requires_grad=True)
    penalised(torch.zeros(3, dtype=F64), cost, torch.tensor(3.0)).sum().backward()
    assert_close(cost.grad, torch.full((3,), -0.75, dtype=F64))
