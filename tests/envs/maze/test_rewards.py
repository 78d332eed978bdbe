from __future__ import annotations

from itertools import pairwise

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from ppt_rl.envs.maze.rewards import MazeRewards, arrival, contact, failure, free_space, progress

F64 = torch.float64
WEIGHTS = MazeRewards(
    progress=2.0, success=5.0, free_space=10.0, cruise=0.05, contact=3.0, force_scale=4.0, jolt=0.5, failure=7.0
)
DT = 0.01


def column(*values: float) -> Tensor:
    return torch.tensor(values, dtype=F64).unsqueeze(-1)


def flags(*values: bool) -> Tensor:
    return torch.tensor(values).unsqueeze(-1)


def touch(force: list[float], acceleration: list[float], dt: float = DT) -> Tensor:
    return contact(
        WEIGHTS, force=torch.tensor([force], dtype=F64), acceleration=torch.tensor([acceleration], dtype=F64), dt=dt
    )


# -- progress and arrival ----------------------------------------------------------------------------------------------


def test_progress_is_the_share_of_the_centre_line_made_in_the_step_with_its_sign() -> None:
    got = progress(WEIGHTS, travelled=column(0.3, 0.1, 0.2), previous=column(0.2, 0.2, 0.2), length=column(0.8))
    assert_close(got, column(2 * 0.125, -2 * 0.125, 0.0))


@pytest.mark.parametrize("path", [[0.0, 0.3, 0.8], [0.0, 0.5, 0.2, 0.6, 0.8]])
def test_progress_over_an_episode_depends_on_its_ends_and_not_on_its_detours(path: list[float]) -> None:
    steps = [
        progress(WEIGHTS, travelled=column(now), previous=column(before), length=column(0.8))
        for before, now in pairwise(path)
    ]
    assert_close(sum(steps), column(2.0))


def test_arrival_pays_where_the_end_is_reached_and_nowhere_else() -> None:
    assert_close(arrival(WEIGHTS, success=flags(True, False)).to(F64), column(5.0, 0.0))


# -- free space --------------------------------------------------------------------------------------------------------


def test_cruising_is_free_and_standing_costs_as_much_as_twice_the_cruising_speed() -> None:
    got = free_space(WEIGHTS, speed=column(0.05, 0.0, 0.10), dt=DT)
    assert_close(got, column(0.0, -10 * DT, -10 * DT))


def test_the_penalty_on_speed_grows_with_the_square_of_its_relative_deviation() -> None:
    small, large = free_space(WEIGHTS, speed=column(0.055, 0.065), dt=DT)
    assert_close(large, 9 * small)


# -- contact and failure -----------------------------------------------------------------------------------------------


def test_a_force_of_the_scale_costs_the_weight_and_twice_the_force_four_times_as_much() -> None:
    assert_close(touch([4.0, 0.0], [0.0, 0.0, 0.0]), column(-3 * DT))
    assert_close(touch([0.0, -8.0], [0.0, 0.0, 0.0]), column(-12 * DT))


def test_an_acceleration_costs_its_square() -> None:
    assert_close(touch([0.0, 0.0], [1.0, 2.0, -2.0]), column(-0.5 * 9 * DT))


def test_force_and_acceleration_add_up() -> None:
    both = touch([3.0, 4.0], [1.0, 0.0, 0.0])
    assert_close(both, touch([3.0, 4.0], [0.0, 0.0, 0.0]) + touch([0.0, 0.0], [1.0, 0.0, 0.0]))


def test_light_contact_for_long_is_cheaper_than_the_same_impulse_at_once() -> None:
    light = 10 * touch([1.0, 0.0], [0.0, 0.0, 0.0])
    assert_close(touch([10.0, 0.0], [0.0, 0.0, 0.0]), 10 * light)


def test_a_failure_costs_its_weight() -> None:
    assert_close(failure(WEIGHTS, failed=flags(True, False)).to(F64), column(-7.0, 0.0))


def test_running_penalties_are_rates() -> None:
    fine, coarse = (touch([1.0, 2.0], [3.0, 0.0, 0.0], dt) for dt in (DT, 2 * DT))
    assert_close(coarse, 2 * fine)
    fine, coarse = (free_space(WEIGHTS, speed=column(0.02), dt=dt) for dt in (DT, 2 * DT))
    assert_close(coarse, 2 * fine)


# -- all ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_every_term_is_a_column_in_the_precision_of_its_input(dtype: torch.dtype) -> None:
    one = torch.ones(3, 1, dtype=dtype)
    weights = MazeRewards()
    terms = [
        progress(weights, travelled=one, previous=one, length=one),
        free_space(weights, speed=one, dt=DT),
        contact(weights, force=one.expand(3, 2), acceleration=one.expand(3, 3), dt=DT),
    ]
    for term in terms:
        assert term.shape == (3, 1)
        assert term.dtype == dtype
