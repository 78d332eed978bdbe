from __future__ import annotations

import math

import numpy as np
import pytest

from ppt_rl.envs import MazeLayout, MazeRandomisation, Straight, Turn, paper_layout
from ppt_rl.envs.maze.geometry import build_corridor
from ppt_rl.envs.maze.start import check_start, draw_start

RADIUS = 0.0125


def drawn(layout: MazeLayout, *, along: float, across: float = 0.0) -> np.ndarray:
    ranges = MazeRandomisation(along=(along, along), across=(across, across))
    return draw_start(np.random.default_rng(0), ranges, layout, build_corridor(layout), RADIUS)


def test_the_tool_starts_at_its_distance_from_the_closed_end_and_its_offset_to_the_left() -> None:
    layout = MazeLayout((Straight(0.3),), width=0.055, start=(0.45, -0.2), heading=math.pi / 2, height=0.02)
    free = 0.5 * 0.055 - RADIUS
    np.testing.assert_allclose(drawn(layout, along=0.04, across=0.5), [0.45 - 0.5 * free, -0.16, 0.0205], atol=1e-12)


def test_the_tool_starts_above_the_highest_floor_under_it_where_a_ramp_begins_there() -> None:
    layout = MazeLayout((Straight(0.12, rise=0.02),), start=(0.45, -0.2))
    foot = build_corridor(layout).centre[1]
    slope = 0.02 / (0.12 - 2 * float(foot[1] + 0.2))
    above = drawn(layout, along=float(foot[1] + 0.2))[2]
    assert above == pytest.approx(5e-4 + slope * RADIUS)


def test_the_start_fills_its_ranges() -> None:
    layout, rng = paper_layout(), np.random.default_rng(0)
    corridor, ranges = build_corridor(layout), MazeRandomisation()
    starts = np.asarray([draw_start(rng, ranges, layout, corridor, RADIUS) for _ in range(200)])
    free = 0.5 * layout.width - RADIUS
    along, across = starts[:, 1] - layout.start[1], (layout.start[0] - starts[:, 0]) / free
    for values, (low, high) in ((along, ranges.along), (across, ranges.across)):
        assert low <= values.min() < low + 0.05 * (high - low)
        assert high >= values.max() > high - 0.05 * (high - low)


def test_a_first_straight_without_room_for_the_tool_is_refused() -> None:
    corner = (Turn(1.2), Straight(0.2))
    check_start(MazeLayout((Straight(0.055), *corner)))
    with pytest.raises(ValueError, match=r"the first segment is .*; expected a length of at least 0\.055 m"):
        check_start(MazeLayout((Straight(0.054), *corner)))


@pytest.mark.parametrize("name", ["along", "across", "heading_error"])
@pytest.mark.parametrize("limits", [(0.04, 0.03), (math.nan, 0.04)])
def test_a_range_that_is_empty_is_refused(name: str, limits: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match=rf"MazeRandomisation.{name} is .*; expected low <= high\."):
        MazeRandomisation(**{name: limits})


@pytest.mark.parametrize(("name", "limits"), [("along", (0.0, 0.04)), ("across", (-1.0, 0.0)), ("across", (0.0, 0.99))])
def test_a_range_that_puts_the_tool_into_a_wall_is_refused(name: str, limits: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match=r"puts the tool into a wall; expected along >= 0.02 m and across within"):
        MazeRandomisation(**{name: limits})
