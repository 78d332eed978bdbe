from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.testing import assert_close

from ppt_rl.envs import MazeLayout, Straight, Turn, paper_layout
from ppt_rl.envs.maze.episode import MazeEpisodes
from ppt_rl.envs.maze.geometry import WALL_HEIGHT, build_corridor
from tests.envs.maze.mazes import (
    LEVEL,
    SHORT,
    Array,
    Built,
    along,
    built,
    random_mazes,
    random_straights,
    travelled,
    unit,
)

F64 = torch.float64


def corridors() -> Built:
    return [*random_mazes()[:4], *random_straights()[:2], *built(paper_layout(), SHORT, LEVEL)]


def episodes(cases: Built, dtype: torch.dtype = F64) -> MazeEpisodes:
    kept = MazeEpisodes(len(cases), dtype)
    for row, (layout, corridor) in enumerate(cases):
        kept.write(row, corridor, layout.friction)
    return kept


def line(centre: Array, at: Array) -> Array:
    """``(N, 3)`` points of a centre line, at distances ``at`` along it."""
    return np.stack([np.interp(at, travelled(centre), centre[:, i]) for i in range(3)], -1)


def test_a_position_is_the_nearest_point_of_the_centre_line_by_brute_force() -> None:
    cases = corridors()
    kept, rng = episodes(cases), np.random.default_rng(0)
    dense = [line(c.centre, np.linspace(0, c.length, 12000)) for _, c in cases]
    for _ in range(40):
        share = rng.uniform(0, 1, len(cases))
        near = np.stack([points[int(12000 * part)] for points, part in zip(dense, share, strict=True)])
        position = near + np.concatenate([rng.normal(0, 0.02, (len(cases), 2)), rng.normal(0, 0.1, (len(cases), 1))], 1)
        located = kept.locate(torch.from_numpy(position))._asdict()
        nearest = {name: value.squeeze(-1).numpy() for name, value in located.items()}
        for row, (_, corridor) in enumerate(cases):
            tool = position[row, :2]
            found = line(corridor.centre, nearest["travelled"][row : row + 1])[0]
            away = np.linalg.norm(tool - found[:2])
            least = np.linalg.norm(dense[row][:, :2] - tool, axis=-1).min()
            assert away <= least + 1e-9
            assert abs(nearest["offset"][row]) == pytest.approx(away, abs=1e-9)
            assert nearest["floor"][row] == pytest.approx(found[2], abs=1e-9)


@pytest.mark.parametrize(("dtype", "atol"), [(F64, 1e-9), (torch.float32, 2e-6)])
def test_a_position_has_the_offset_heading_floor_and_width_of_its_point(dtype: torch.dtype, atol: float) -> None:
    cases = corridors()
    kept = episodes(cases, dtype)
    aside = np.linspace(-0.004, 0.004, len(cases))
    spots = [along(corridor, 3) for _, corridor in cases]
    for k in range(max(len(points) for points, _, _ in spots)):
        points, headings, piece = (np.stack([spot[i][k % len(spot[0])] for spot in spots]) for i in range(3))
        position = points.copy()
        position[:, :2] += aside[:, None] * unit(headings + 0.5 * math.pi)
        located = kept.locate(torch.from_numpy(position).to(dtype))
        assert all(value.shape == (len(cases), 1) and value.dtype == dtype for value in located)
        expected = {
            "travelled": np.asarray([_distance_to(c.centre, p) for (_, c), p in zip(cases, points, strict=True)]),
            "offset": aside,
            "floor": points[:, 2],
            "half_width": np.asarray([c.half_width[i] for (_, c), i in zip(cases, piece, strict=True)]),
            "heading": headings,
        }
        for name, value in expected.items():
            got = getattr(located, name).squeeze(-1)
            assert_close(got, torch.from_numpy(value).to(dtype), rtol=0, atol=30 * atol if name == "heading" else atol)


def _distance_to(centre: Array, point: Array) -> float:
    """Distance along a centre line to a point on it [m]."""
    begin, end = centre[:-1, :2], centre[1:, :2]
    first, second = np.linalg.norm(point[:2] - begin, axis=-1), np.linalg.norm(point[:2] - end, axis=-1)
    piece = int((first + second - np.linalg.norm(end - begin, axis=-1)).argmin())
    return float(travelled(centre)[piece] + first[piece])


def test_the_distance_travelled_lies_between_zero_and_the_length() -> None:
    cases = corridors()
    kept = episodes(cases)
    ends = []
    for index, beyond in ((0, -0.05), (0, 0.0), (-1, 0.0), (-1, 0.05)):
        heading = [along(corridor)[1][index] for _, corridor in cases]
        point = np.stack([corridor.centre[index] for _, corridor in cases])
        point[:, :2] += beyond * unit(np.asarray(heading))
        ends.append(kept.locate(torch.from_numpy(point)).travelled.squeeze(-1))
    length = torch.tensor([corridor.length for _, corridor in cases], dtype=F64)
    assert_close(kept.length.squeeze(-1), length)
    for got, expected in zip(ends, [0 * length, 0 * length, length, length], strict=True):
        assert_close(got, expected, rtol=0, atol=1e-9)


def test_a_new_maze_of_an_environment_keeps_nothing_of_the_old_one() -> None:
    long, short = built(paper_layout(), replace(SHORT, width=0.05))
    used, fresh = episodes([long, long]), episodes([short, long])
    used.write(0, short[1], short[0].friction)
    for name in ("centre", "half_width", "at", "length"):
        assert torch.equal(getattr(used, name), getattr(fresh, name)), name
    assert used.friction.tolist() == fresh.friction.tolist()


def test_beginning_an_episode_changes_neither_other_environments_nor_earlier_observations() -> None:
    kept = episodes(corridors()[:3])
    kept.begin(np.arange(3), np.asarray([0.1, 0.2, 0.3]))
    kept.over = torch.tensor([[True], [True], [False]])
    told = kept.start_heading
    kept.begin(np.asarray([1]), np.asarray([0.9]))
    assert_close(told.squeeze(-1), torch.tensor([0.1, 0.2, 0.3], dtype=F64))
    assert_close(kept.start_heading.squeeze(-1), torch.tensor([0.1, 0.9, 0.3], dtype=F64))
    assert kept.over.squeeze(-1).tolist() == [True, False, False]


def test_an_episode_fails_outside_the_walls_above_them_and_at_a_large_force_and_then_is_no_success() -> None:
    kept = episodes([*built(LEVEL)] * 6)
    end = LEVEL.segments[0].length  # type: ignore[union-attr]
    cases = [  # along, to the left, above the floor [m], force [N]
        (end, 0.0, 0.0, 9.0), (0.1, 0.0, 0.0, 9.0), (end, 0.03, 0.0, 0.0), (end, 0.0, 0.81 * WALL_HEIGHT, 0.0),
        (end, 0.0, 0.0, 10.1), (0.1, 0.027, 0.79 * WALL_HEIGHT, -9.9),
    ]  # fmt: skip
    x, y = LEVEL.start
    point = torch.tensor([[x - left, y + along, above] for along, left, above, _ in cases], dtype=F64)
    force = torch.tensor([[0.0, 0.0, size] for *_, size in cases], dtype=F64)
    found = kept.judge(kept.locate(point), point[:, 2:3], force, max_force=10.0)
    assert found.success.squeeze(-1).tolist() == [True] + [False] * 5
    assert found.left_corridor.squeeze(-1).tolist() == [False, False, True, True, False, False]
    assert found.unsafe.squeeze(-1).tolist() == [False, False, False, False, True, False]
    assert torch.equal(found.failed, found.left_corridor | found.unsafe)


def test_a_centre_line_with_too_many_corners_is_refused() -> None:
    segments = (Straight(0.03), *(Turn(0.1), Straight(0.03), Turn(-0.1), Straight(0.03)) * 20)
    with pytest.raises(ValueError, match=r"centre line has 42 corners; expected at most 40\. Shorten it\."):
        MazeEpisodes(1, F64).write(0, build_corridor(MazeLayout(segments)), 0.2)
