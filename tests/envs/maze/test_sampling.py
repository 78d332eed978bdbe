from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from ppt_rl.arms import PANDA
from ppt_rl.envs.maze import sampling
from ppt_rl.envs.maze.feasibility import check_corridor
from ppt_rl.envs.maze.layout import Disc, MazeLayout, Straight, Turn
from ppt_rl.envs.maze.sampling import MazeRanges, StraightRanges, random_maze, random_straight
from tests.envs.maze.mazes import random_mazes, random_straights, walk


@pytest.mark.parametrize("draw", [random_maze, random_straight])
def test_the_same_seed_draws_the_same_layout_and_another_seed_another_one(draw: Any) -> None:
    first, again, other = (draw(np.random.default_rng(seed)) for seed in (5, 5, 6))
    assert first == again
    assert first != other


def test_every_random_layout_is_feasible() -> None:
    for layout, corridor in [*random_mazes(), *random_straights()]:
        check_corridor(corridor, layout, PANDA.reach)


def test_a_random_straight_is_one_level_straight_within_its_ranges_and_fills_them() -> None:
    ranges = StraightRanges()
    drawn: dict[str, list[float]] = {}
    for layout, _ in random_straights():
        assert [type(segment) for segment in layout.segments] == [Straight]
        assert layout.is_straight
        (straight, middle, _), *_ = walk(layout)
        assert straight.rise == 0
        values = (straight.length, layout.width, layout.friction, layout.height, *middle)
        for name, value in zip(vars(ranges), values, strict=True):
            drawn.setdefault(name, []).append(value)
    for name, numbers in drawn.items():
        low, high = getattr(ranges, name)
        assert low - 1e-9 <= min(numbers) < low + 0.25 * (high - low), name
        assert high + 1e-9 >= max(numbers) > high - 0.25 * (high - low), name


def test_the_parts_of_a_random_maze_are_within_their_ranges() -> None:
    ranges, angles = MazeRanges(), []
    for layout, _ in random_mazes():
        turns = [part.angle for part in layout.segments if isinstance(part, Turn)]
        discs = [part for part in layout.segments if isinstance(part, Disc)]
        rises = [part.rise for part in layout.segments if isinstance(part, Straight) and part.rise]
        angles += turns
        assert ranges.turns[0] <= len(turns) <= ranges.turns[1]
        assert len(discs) == 1
        assert ranges.disc[0] <= discs[0].diameter <= ranges.disc[1]
        assert discs[0].angle == 0
        assert len(rises) == 2
        assert ranges.rise[0] <= rises[0] == -rises[1] <= ranges.rise[1]
        assert ranges.width[0] <= layout.width <= ranges.width[1]
        assert ranges.friction[0] <= layout.friction <= ranges.friction[1]
    assert min(map(abs, angles)) >= ranges.turn[0]
    assert max(map(abs, angles)) <= ranges.turn[1]
    assert {angle > 0 for angle in angles} == {True, False}


def test_the_total_length_of_the_segments_of_a_random_maze_is_in_its_range() -> None:
    def length(layout: MazeLayout) -> float:
        parts = [part for part in layout.segments if not isinstance(part, Turn)]
        return sum(part.length if isinstance(part, Straight) else part.diameter for part in parts)

    assert all(0.9 - 1e-9 <= length(layout) <= 1.1 + 1e-9 for layout, _ in random_mazes())
    assert length(random_maze(np.random.default_rng(0), MazeRanges(length=(1.0, 1.0)))) == pytest.approx(1.0)


def test_a_range_of_a_single_number_fixes_that_quantity() -> None:
    ranges = MazeRanges(turn=(0.5, 0.5), turns=(2, 2), discs=(0, 0), width=(0.053, 0.053), rise=(0.02, 0.02))
    layout = random_maze(np.random.default_rng(0), ranges)
    assert [abs(part.angle) for part in layout.segments if not isinstance(part, Straight)] == [0.5, 0.5]
    assert [part.rise for part in layout.segments if isinstance(part, Straight) and part.rise] == [0.02, -0.02]
    assert layout.width == 0.053


@pytest.mark.parametrize("ranges", [MazeRanges, StraightRanges])
@pytest.mark.parametrize("limits", [(0.2, 0.1), (math.nan, 0.1)])
def test_an_empty_range_is_refused(ranges: Any, limits: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match=rf"{ranges.__name__}.friction is .*; expected low <= high\."):
        ranges(friction=limits)


@pytest.mark.parametrize(
    ("draw", "ranges", "message"),
    [
        (
            random_maze,
            MazeRanges(length=(0.2, 0.3)),
            r"none of 20 layouts within MazeRanges.* fits",
        ),
        (random_straight, StraightRanges(x=(0.1, 0.1)), r"none of 20 layouts within StraightRanges.* fits"),
    ],
)
def test_ranges_in_which_nothing_is_feasible_are_refused(
    monkeypatch: pytest.MonkeyPatch, draw: Any, ranges: Any, message: str
) -> None:
    monkeypatch.setattr(sampling, "_TRIES", 20)
    with pytest.raises(ValueError, match=message):
        draw(np.random.default_rng(0), ranges)
