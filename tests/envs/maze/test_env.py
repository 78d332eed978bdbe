from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from ppt_rl.envs import MazeLayout, MazeRanges, MazeRewards, PandaMazeEnv, StraightRanges
from ppt_rl.envs.maze import source as maze_source
from ppt_rl.envs.maze.layout import Disc, Straight, Turn, paper_layout
from tests.engines import COARSE
from tests.envs.maze.mazes import LEVEL, SHORT, drag, layouts_of
from tests.envs.scenes import leaves, rollout, torques

F64 = torch.float64
FAST: dict[str, Any] = {"engine": COARSE, "seed": 0}
Make = Callable[..., PandaMazeEnv]
MAKES: list[Make] = [PandaMazeEnv.straight, PandaMazeEnv.mazes]


def of_three(num_envs: int = 3, **kwargs: Any) -> PandaMazeEnv:
    return PandaMazeEnv.of([SHORT, LEVEL, paper_layout()], num_envs, **kwargs)


# -- specs and seeds ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [torch.float32, F64])
@pytest.mark.parametrize("make", [*MAKES, of_three])
def test_observations_fit_the_specs(make: Make, dtype: torch.dtype) -> None:
    check_env_specs(make(2, duration=0.05, dtype=dtype, **FAST))


def test_privileged_observations_have_names_of_their_own() -> None:
    observation = PandaMazeEnv.straight(2, **FAST).reset()
    for name in ("start_heading", "corridor_offset", "corridor_heading", "progress"):
        assert observation[name].shape == (2, 1), name
    assert not observation["progress"].isnan().any()


@pytest.mark.parametrize("make", MAKES)
def test_the_same_seed_repeats_mazes_and_episodes_and_another_seed_does_not(make: Make) -> None:
    drawn = []
    for seed in (3, 3, 4):
        env = make(3, **{**FAST, "seed": seed})
        run = rollout(env, torques(env, 4)), rollout(env, torques(env, 4))
        drawn.append((layouts_of(env), *run))
    first, again, other = drawn
    assert first[0] == again[0]
    for a, b in zip(first[1:], again[1:], strict=True):
        assert all(torch.equal(leaves(a)[name], leaves(b)[name]) for name in leaves(a))
    assert all(a != b for a, b in zip(first[0], other[0], strict=True))


def test_training_and_test_draw_different_numbers_with_the_same_seed(monkeypatch: pytest.MonkeyPatch) -> None:
    numbers: list[float] = []

    def record(rng: np.random.Generator, *_: Any) -> MazeLayout:
        numbers.append(rng.uniform())
        return LEVEL

    monkeypatch.setattr(maze_source, "random_straight", record)
    monkeypatch.setattr(maze_source, "random_maze", record)
    for make in MAKES:
        make(4, **FAST).reset()
    assert len(set(numbers)) == 8


# -- which mazes -------------------------------------------------------------------------------------------------------


def test_the_training_set_has_no_turns() -> None:
    env = PandaMazeEnv.straight(8, **FAST)
    for _ in range(12):
        observation = env.reset()
        assert all(layout.is_straight for layout in layouts_of(env))
        told = torch.tensor([layout.heading for layout in layouts_of(env)])
        assert_close(observation["corridor_heading"].squeeze(-1), told, rtol=0, atol=1e-4)


def test_every_maze_of_the_test_set_has_turns_discs_and_ramps() -> None:
    env = PandaMazeEnv.mazes(4, **FAST)
    before: list[MazeLayout] = []
    for _ in range(2):
        env.reset()
        assert not set(layouts_of(env)) & set(before)
        before += layouts_of(env)
    for layout in before:
        assert {type(segment) for segment in layout.segments} == {Straight, Turn, Disc}
        assert any(isinstance(segment, Straight) and segment.rise for segment in layout.segments)


def test_given_ranges_are_used() -> None:
    straight = PandaMazeEnv.straight(2, ranges=StraightRanges(length=(0.21, 0.21)), **FAST)
    mazes = PandaMazeEnv.mazes(2, ranges=MazeRanges(friction=(0.15, 0.15)), **FAST)
    for env in (straight, mazes):
        env.reset()
    assert all(layout.segments == (Straight(0.21),) for layout in layouts_of(straight))
    assert all(layout.friction == 0.15 for layout in layouts_of(mazes))


def test_given_layouts_are_used_in_turn() -> None:
    env = of_three(2, **FAST)
    taken = []
    for _ in range(3):
        env.reset()
        taken += layouts_of(env)
    assert taken == [SHORT, LEVEL, paper_layout()] * 2
    assert PandaMazeEnv.of([LEVEL, SHORT], **FAST).num_envs == 2


# -- bad input ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("force", [0.0, -1.0, math.nan])
def test_a_force_limit_that_is_not_positive_is_refused(force: float) -> None:
    with pytest.raises(ValueError, match=r"max_force is .*; expected a force above 0 N\."):
        PandaMazeEnv.straight(1, max_force=force)


def test_an_empty_list_of_layouts_is_refused() -> None:
    with pytest.raises(ValueError, match=r"layouts is empty; expected at least one MazeLayout\."):
        PandaMazeEnv.of([])


def test_an_infeasible_layout_is_refused_before_the_first_episode() -> None:
    with pytest.raises(ValueError, match=r"the maze lies .* Move its start"):
        PandaMazeEnv.of([LEVEL, replace(LEVEL, start=(1.0, 0.0))])


def test_given_reward_weights_are_used() -> None:
    light, heavy = (
        PandaMazeEnv.of([LEVEL], rewards=MazeRewards(progress=weight, success=0.0), dtype=F64, **FAST)
        for weight in (1.0, 3.0)
    )
    first, second = (drag(env, 0.08, [0.007], 0.2)["reward_terms", "progress"] for env in (light, heavy))
    assert (first[1:] != 0).all()
    assert_close(second, 3 * first)
