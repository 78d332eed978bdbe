from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from ppt_rl.arms import PANDA
from ppt_rl.envs.maze.feasibility import check_corridor
from ppt_rl.envs.maze.geometry import WALL_HEIGHT, build_corridor
from ppt_rl.envs.maze.layout import Disc, MazeLayout, Straight, Turn, paper_layout
from tests.envs.maze.mazes import (
    SHORT,
    Built,
    along,
    built,
    gaps,
    height_on,
    line_length,
    open_end,
    random_mazes,
    random_straights,
    seen,
    seen_walls,
    unit,
    walk,
)


@pytest.fixture(scope="module")
def corridors() -> Built:
    bent = replace(SHORT, segments=(*SHORT.segments[:3], Disc(0.10, -0.9), *SHORT.segments[4:]))
    return [*random_mazes(), *random_straights(), *built(paper_layout(), SHORT, bent)]


# -- walls -------------------------------------------------------------------------------------------------------------


def test_the_walls_of_a_side_join_without_a_gap(corridors: Built) -> None:
    for _, corridor in corridors:
        for side in (1.0, -1.0):
            faces = [face for face in corridor.faces[1:] if face.outward == side]
            assert all(np.array_equal(face.end, following.begin) for face, following in pairwise(faces))


def test_the_first_wall_closes_the_start_from_side_to_side(corridors: Built) -> None:
    for layout, corridor in corridors:
        back, *sides = corridor.faces
        first = [next(face for face in sides if face.outward == side).begin for side in (1.0, -1.0)]
        np.testing.assert_array_equal([back.begin, back.end], first)
        np.testing.assert_allclose(0.5 * (back.begin + back.end), layout.start, rtol=0, atol=1e-12)
        assert np.linalg.norm(back.end - back.begin) == pytest.approx(layout.width)


def test_a_ray_on_the_map_leaves_a_maze_through_its_open_end_only(corridors: Built) -> None:
    angles = np.linspace(-math.pi, math.pi, 90, endpoint=False) + 1e-3
    for _, corridor in corridors:
        for point in along(corridor, 2)[0]:
            out = np.isinf(seen_walls(point, angles, corridor))
            assert not (out & np.isinf(seen(point, angles, *open_end(corridor)))).any()


def test_no_wall_is_nearer_to_the_centre_line_than_half_the_width(corridors: Built) -> None:
    for layout, corridor in corridors:
        points = along(corridor)[0]
        assert gaps(points, corridor.faces[1:]).min() >= 0.5 * layout.width - 1e-9


def test_the_walls_are_the_corridors_width_apart_in_the_middle_of_every_straight(corridors: Built) -> None:
    for layout, corridor in corridors:
        for _, middle, heading in walk(layout):
            right, left = seen_walls(middle, heading + np.asarray([-0.5, 0.5]) * math.pi, corridor)
            assert (left, right) == pytest.approx((0.5 * layout.width,) * 2, abs=1e-9)


def test_the_half_width_of_a_piece_is_the_largest_distance_to_its_walls(corridors: Built) -> None:
    for layout, corridor in corridors:
        widest = [0.5 * part.diameter for part in layout.segments if isinstance(part, Disc)]
        assert set(corridor.half_width.tolist()) == {0.5 * layout.width, *widest}


def test_the_top_of_a_wall_is_its_height_above_the_highest_floor_beside_it(corridors: Built) -> None:
    for _, corridor in corridors:
        for face in corridor.faces[1:]:
            inside = -face.outward * np.asarray([[0.0, -1.0], [1.0, 0.0]]) @ (face.end - face.begin)
            inside = 0.005 * inside / np.linalg.norm(inside)
            spots = face.begin + np.asarray([[0.02], [0.5], [0.98]]) * (face.end - face.begin) + inside
            highest = height_on(corridor.floors, spots).max()
            assert face.top == pytest.approx(highest + WALL_HEIGHT, abs=1e-9)


# -- floor and centre line ---------------------------------------------------------------------------------------------


def test_the_centre_line_runs_through_the_middles_of_the_straights_and_is_as_long_as_its_parts(
    corridors: Built,
) -> None:
    for layout, corridor in corridors:
        assert corridor.length == pytest.approx(line_length(layout))
        begin, edge = corridor.centre[:-1, :2], np.diff(corridor.centre[:, :2], axis=0)
        for _, middle, _ in walk(layout):
            share = (((middle - begin) * edge).sum(-1) / (edge**2).sum(-1)).clip(0, 1)
            assert np.linalg.norm(begin + share[:, None] * edge - middle, axis=-1).min() < 1e-9


def test_the_floor_has_the_height_of_the_centre_line_from_wall_to_wall(corridors: Built) -> None:
    for layout, corridor in corridors:
        points, heading, _ = along(corridor)
        for share in (-0.499, -0.25, 0.0, 0.25, 0.499):
            points_aside = points[:, :2] + share * layout.width * unit(heading + 0.5 * math.pi)
            np.testing.assert_allclose(height_on(corridor.floors, points_aside), points[:, 2], rtol=0, atol=1e-6)


def test_the_floor_of_a_wide_corner_does_not_cover_a_ramp_downwards() -> None:
    segments = (Straight(0.15), Turn(math.radians(45)), Straight(0.25, rise=-0.04))
    layout = MazeLayout(segments, width=0.10, height=0.05, start=(0.50, -0.20))
    ((_, corridor),) = built(layout)
    check_corridor(corridor, layout, PANDA.reach)
    points, heading, _ = along(corridor, 60)
    points, heading = points[points[:, 2] < 0.05], heading[points[:, 2] < 0.05]
    for aside in (0.0, 0.01, 0.02, 0.03, 0.04):
        points_aside = points[:, :2] + aside * unit(heading + 0.5 * math.pi)
        np.testing.assert_allclose(height_on(corridor.floors, points_aside), points[:, 2], rtol=0, atol=1e-6)


def test_the_floor_reaches_beyond_the_open_end(corridors: Built) -> None:
    for layout, corridor in corridors:
        beyond = corridor.centre[-1, :2] + 0.03 * unit(walk(layout)[-1][2])
        assert height_on(corridor.floors, beyond[None]) == pytest.approx(corridor.centre[-1, 2], abs=1e-9)


def test_a_ramp_rises_as_far_as_asked_between_level_ends() -> None:
    corridor = build_corridor(MazeLayout((Straight(0.2, rise=0.03),), start=(0.45, -0.1)))
    np.testing.assert_allclose(corridor.centre[:, 2], [0.0, 0.0, 0.03, 0.03], rtol=0, atol=1e-12)


# -- what cannot be built ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("length", [0.04, 0.06])
def test_a_straight_without_room_for_its_ramp_is_refused(length: float) -> None:
    layout = MazeLayout((Straight(length, rise=0.01),), start=(0.5, -0.1))
    with pytest.raises(ValueError, match=r"no room for its ramp .*; expected a length of at least 0\.075 m\."):
        build_corridor(layout)


def test_a_disc_no_wider_than_the_corridor_is_refused() -> None:
    layout = MazeLayout((Straight(0.1), Disc(0.07), Straight(0.1)), width=0.07)
    with pytest.raises(ValueError, match=r"Disc.diameter is 0.07 m in a corridor 0.07 m wide; expected a wider disc\."):
        build_corridor(layout)
