from __future__ import annotations

import math
from itertools import pairwise

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from ppt_rl.envs.push.rewards import PushRewards, arrival, contact, free_space, progress

F64 = torch.float64
WEIGHTS = PushRewards(progress=2.0, precision=3.0, success=5.0, free_space=0.5, contact=0.4, force_limit=4.0)


def column(*values: float) -> Tensor:
    return torch.tensor(values, dtype=F64).unsqueeze(-1)


def flags(*values: bool) -> Tensor:
    return torch.tensor(values).unsqueeze(-1)


def approach(distance: Tensor, previous: Tensor, initial: Tensor, touched: Tensor) -> Tensor:
    return free_space(WEIGHTS, distance=distance, previous=previous, initial=initial, touched=touched)


# -- progress ----------------------------------------------------------------------------------------------------------


def test_progress_is_the_share_of_the_initial_distance_closed_in_the_step_with_its_sign() -> None:
    got = progress(WEIGHTS, distance=column(0.1, 0.3, 0.2), previous=column(0.2, 0.2, 0.2), initial=column(0.4))
    assert_close(got, column(2 * 0.25, -2 * 0.25, 0.0))


@pytest.mark.parametrize("path", [[0.4, 0.3, 0.1], [0.4, 0.6, 0.2, 0.35, 0.1]])
def test_progress_over_an_episode_depends_on_its_ends_and_not_on_its_detours(path: list[float]) -> None:
    initial = column(path[0])
    steps = [
        progress(WEIGHTS, distance=column(now), previous=column(before), initial=initial)
        for before, now in pairwise(path)
    ]
    assert_close(sum(steps), column(2 * 0.75))


def test_near_and_far_goals_are_worth_the_same() -> None:
    near, far = column(0.1), column(0.8)
    for initial in (near, far):
        assert_close(progress(WEIGHTS, distance=0 * initial, previous=initial, initial=initial), column(2.0))


# -- arrival -----------------------------------------------------------------------------------------------------------


def test_arrival_is_an_exponential_of_the_distance_in_success_radii_plus_the_success() -> None:
    got = arrival(
        WEIGHTS, distance=column(0.0, 0.02, 0.04), success=flags(True, True, False), ended=flags(True), radius=0.02
    )
    assert_close(got, column(3 + 5, 3 / math.e + 5, 3 / math.e**2))


def test_arrival_pays_nothing_before_the_end() -> None:
    got = arrival(WEIGHTS, distance=column(0.0), success=flags(True), ended=flags(False), radius=0.02)
    assert_close(got, column(0.0))


def test_arrival_still_has_a_gradient_towards_the_goal_outside_the_success_radius() -> None:
    distance = column(0.03).requires_grad_()
    arrival(WEIGHTS, distance=distance, success=flags(False), ended=flags(True), radius=0.02).sum().backward()
    assert distance.grad is not None
    assert_close(distance.grad, column(-3 / 0.02 * math.exp(-1.5)))


# -- free space --------------------------------------------------------------------------------------------------------


def test_approach_is_the_share_of_the_initial_distance_closed_in_the_step_until_the_first_touch() -> None:
    got = approach(column(0.1, 0.3, 0.1), column(0.2, 0.2, 0.2), column(0.4), flags(False, False, True))
    assert_close(got, column(0.5 * 0.25, -0.5 * 0.25, 0.0))


def test_a_tool_that_moves_back_after_a_touch_is_not_penalised() -> None:
    assert approach(column(0.3), column(0.1), column(0.4), flags(True)) == 0


def test_the_whole_approach_is_worth_its_weight() -> None:
    path = [0.4, 0.25, 0.3, 0.0]
    steps = [approach(column(now), column(before), column(0.4), flags(False)) for before, now in pairwise(path)]
    assert_close(sum(steps), column(0.5))


# -- contact -----------------------------------------------------------------------------------------------------------


def test_force_up_to_the_limit_is_free_and_the_excess_costs_in_proportion() -> None:
    got = contact(WEIGHTS, force=column(0.0, 3.9, 4.0, 5.0, 14.0), dt=0.01)
    assert_close(got, column(0.0, 0.0, 0.0, -0.4 * 0.01, -0.4 * 10 * 0.01))


def test_the_penalty_on_force_is_a_rate() -> None:
    fine, coarse = (contact(WEIGHTS, force=column(7.0), dt=dt) for dt in (0.01, 0.02))
    assert_close(coarse, 2 * fine)


# -- all ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_every_term_is_a_column_in_the_precision_of_its_input(dtype: torch.dtype) -> None:
    one, yes = torch.ones(3, 1, dtype=dtype), torch.ones(3, 1, dtype=torch.bool)
    weights = PushRewards()
    terms = [
        progress(weights, distance=one, previous=one, initial=one),
        arrival(weights, distance=one, success=yes, ended=yes, radius=0.02),
        free_space(weights, distance=one, previous=one, initial=one, touched=~yes),
        contact(weights, force=one, dt=0.01),
    ]
    for term in terms:
        assert term.shape == (3, 1)
        assert term.dtype == dtype
