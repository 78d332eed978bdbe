from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.testing import assert_close

from ppt_rl.envs import MazeLayout, MazeRandomisation, Straight, Turn, paper_layout
from ppt_rl.envs.maze.episode import MazeEpisodes
from ppt_rl.envs.maze.geometry import build_corridor
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
    """``(N, 3)`` points of a centre line, ways ``at`` along it on the map."""
    return np.stack([np.interp(at, travelled(centre), centre[:, i]) for i in range(3)], -1)


def test_a_place_is_the_nearest_of_the_centre_line_by_brute_force() -> None:
    cases = corridors()
    kept, rng = episodes(cases), np.random.default_rng(0)
    dense = [line(c.centre, np.linspace(0, c.length, 12000)) for _, c in cases]
    for _ in range(40):
        share = rng.uniform(0, 1, len(cases))
        near = np.stack([points[int(12000 * part)] for points, part in zip(dense, share, strict=True)])
        position = near + np.concatenate([rng.normal(0, 0.02, (len(cases), 2)), rng.normal(0, 0.1, (len(cases), 1))], 1)
        place = {
            name: value.squeeze(-1).numpy() for name, value in kept.locate(torch.from_numpy(position))._asdict().items()
        }
        for row, (_, corridor) in enumerate(cases):
            tool = position[row, :2]
            found = line(corridor.centre, place["travelled"][row : row + 1])[0]
            away = np.linalg.norm(tool - found[:2])
            least = np.linalg.norm(dense[row][:, :2] - tool, axis=-1).min()
            assert away <= least + 1e-9
            assert abs(place["offset"][row]) == pytest.approx(away, abs=1e-9)
            assert place["floor"][row] == pytest.approx(found[2], abs=1e-9)


@pytest.mark.parametrize(("dtype", "atol"), [(F64, 1e-9), (torch.float32, 2e-6)])
def test_a_place_has_its_side_its_heading_and_its_room(dtype: torch.dtype, atol: float) -> None:
    cases = corridors()
    kept = episodes(cases, dtype)
    aside = np.linspace(-0.004, 0.004, len(cases))
    spots = [along(corridor, 3) for _, corridor in cases]
    for k in range(max(len(points) for points, _, _ in spots)):
        points, headings, piece = (np.stack([spot[i][k % len(spot[0])] for spot in spots]) for i in range(3))
        position = points.copy()
        position[:, :2] += aside[:, None] * unit(headings + 0.5 * math.pi)
        place = kept.locate(torch.from_numpy(position).to(dtype))
        assert all(value.shape == (len(cases), 1) and value.dtype == dtype for value in place)
        expected = {
            "travelled": np.asarray([_way_to(c.centre, p) for (_, c), p in zip(cases, points, strict=True)]),
            "offset": aside,
            "floor": points[:, 2],
            "half_width": np.asarray([c.half_width[i] for (_, c), i in zip(cases, piece, strict=True)]),
            "heading": headings,
        }
        for name, value in expected.items():
            got = getattr(place, name).squeeze(-1)
            assert_close(got, torch.from_numpy(value).to(dtype), rtol=0, atol=30 * atol if name == "heading" else atol)


def _way_to(centre: Array, point: Array) -> float:
    """Way along a centre line to a point on it [m]."""
    begin, end = centre[:-1, :2], centre[1:, :2]
    first, second = np.linalg.norm(point[:2] - begin, axis=-1), np.linalg.norm(point[:2] - end, axis=-1)
    piece = int((first + second - np.linalg.norm(end - begin, axis=-1)).argmin())
    return float(travelled(centre)[piece] + first[piece])


def test_travelled_goes_from_nothing_to_the_length_and_no_farther() -> None:
    cases = corridors()
    kept = episodes(cases)
    ends = []
    for index, way in ((0, -0.05), (0, 0.0), (-1, 0.0), (-1, 0.05)):
        heading = [along(corridor)[1][index] for _, corridor in cases]
        point = np.stack([corridor.centre[index] for _, corridor in cases])
        point[:, :2] += way * unit(np.asarray(heading))
        ends.append(kept.locate(torch.from_numpy(point)).travelled.squeeze(-1))
    length = torch.tensor([corridor.length for _, corridor in cases], dtype=F64)
    assert_close(kept.length.squeeze(-1), length)
    for got, expected in zip(ends, [0 * length, 0 * length, length, length], strict=True):
        assert_close(got, expected, rtol=0, atol=1e-9)


def test_a_maze_leaves_nothing_behind_for_the_next_of_its_row() -> None:
    long, short = built(paper_layout(), replace(SHORT, width=0.05))
    used, fresh = episodes([long, long]), episodes([short, long])
    used.write(0, short[1], short[0].friction)
    for name in ("centre", "half_width", "at", "length"):
        assert torch.equal(getattr(used, name), getattr(fresh, name)), name
    assert used.friction.tolist() == fresh.friction.tolist()


def test_an_opened_episode_leaves_the_other_rows_and_earlier_observations_as_they_are() -> None:
    kept = episodes(corridors()[:3])
    kept.begin(np.arange(3), np.asarray([0.1, 0.2, 0.3]))
    kept.over = torch.tensor([[True], [True], [False]])
    told = kept.start_heading
    kept.begin(np.asarray([1]), np.asarray([0.9]))
    assert_close(told.squeeze(-1), torch.tensor([0.1, 0.2, 0.3], dtype=F64))
    assert_close(kept.start_heading.squeeze(-1), torch.tensor([0.1, 0.9, 0.3], dtype=F64))
    assert kept.over.squeeze(-1).tolist() == [True, False, False]


def test_a_centre_line_of_too_many_corners_is_refused() -> None:
    segments = (Straight(0.03), *(Turn(0.1), Straight(0.03), Turn(-0.1), Straight(0.03)) * 20)
    with pytest.raises(ValueError, match=r"centre line has 42 corners; expected at most 40\. Shorten it\."):
        MazeEpisodes(1, F64).write(0, build_corridor(MazeLayout(segments)), 0.2)


# -- randomisation -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["along", "across", "heading_error"])
@pytest.mark.parametrize("limits", [(0.04, 0.03), (math.nan, 0.04)])
def test_a_range_that_is_empty_is_refused(name: str, limits: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match=rf"randomisation range {name} is .*; expected low <= high\."):
        MazeRandomisation(**{name: limits})


@pytest.mark.parametrize(("name", "limits"), [("along", (0.0, 0.04)), ("across", (-1.0, 0.0)), ("across", (0.0, 0.99))])
def test_a_range_that_puts_the_tool_into_a_wall_is_refused(name: str, limits: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match=r"puts the tool into a wall; expected along >= 0.02 m and across within"):
        MazeRandomisation(**{name: limits})
