from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from torch.testing import assert_close

from ppt_rl.envs import MazeRandomisation, PandaMazeEnv
from ppt_rl.envs.maze.geometry import WALL_HEIGHT, build_corridor
from ppt_rl.envs.maze.layout import Disc, MazeLayout, Straight, Turn, paper_layout
from ppt_rl.envs.maze.scene import boxes_of
from tests.engines import COARSE, SPACING, bound, model_of, models_of
from tests.envs.maze.mazes import (
    LEVEL,
    SHORT,
    RayScene,
    along,
    drag,
    open_end,
    random_mazes,
    random_straights,
    seen,
    seen_walls,
    unit,
    walk,
)

LAYOUTS = [paper_layout(), SHORT, LEVEL, *(random_mazes()[i][0] for i in range(3)), random_straights()[0][0]]
FAST: dict[str, Any] = {"engine": COARSE, "seed": 0}
#: Distances between walls [m]: Warp rounds places and turns of pieces within a metre of the base.
EXACT = bound(1e-9, 2 * SPACING)


def pieces(model: mujoco.MjModel) -> list[int]:
    """The walls and floors of a model."""
    return [i for i in range(model.ngeom) if model.geom(i).name.startswith(("wall", "floor"))]


@pytest.fixture(scope="module")
def env() -> Iterator[PandaMazeEnv]:
    env = PandaMazeEnv.of(LAYOUTS, **FAST)
    env.reset()
    yield env
    env.close()


@pytest.fixture(scope="module")
def rows(env: PandaMazeEnv) -> list[RayScene]:
    return [RayScene(env, row) for row in range(env.num_envs)]


# -- the model of an environment contains its maze --------------------------------------------------------------------


def test_the_simulated_walls_are_the_corridors_width_apart_up_to_their_top(rows: list[RayScene]) -> None:
    for row, layout in zip(rows, LAYOUTS, strict=True):
        points = along(build_corridor(layout), 4)[0]
        for _, middle, heading in walk(layout):
            floor = points[np.linalg.norm(points[:, :2] - middle, axis=1).argmin(), 2]
            for height in (0.002, 0.95 * WALL_HEIGHT):
                point = np.asarray([*middle, floor + height])
                sides = [row.wall(point, heading + side * 0.5 * math.pi) for side in (1, -1)]
                assert sides == pytest.approx([0.5 * layout.width] * 2, abs=EXACT)


def test_the_simulated_walls_are_those_of_the_corridor_without_gaps(rows: list[RayScene]) -> None:
    angles = np.linspace(-math.pi, math.pi, 36, endpoint=False) + 0.013
    for row, layout in zip(rows, LAYOUTS, strict=True):
        corridor = build_corridor(layout)
        for point in along(corridor, 2)[0]:
            point[2] = 0.04  # every wall reaches from the table to above this height
            expected = seen_walls(point, angles, corridor)
            assert np.isfinite(seen(point, angles[np.isinf(expected)], *open_end(corridor))).all()
            for angle, distance in zip(angles, expected, strict=True):
                if math.isfinite(distance):
                    assert row.wall(point, angle) == pytest.approx(distance, abs=EXACT)


def test_the_simulated_floor_has_the_height_of_the_centre_line_from_wall_to_wall(rows: list[RayScene]) -> None:
    for row, layout in zip(rows, LAYOUTS, strict=True):
        points, headings, _ = along(build_corridor(layout))
        for point, side in zip(points, unit(headings + 0.5 * math.pi), strict=True):
            for share in (-0.49, -0.2, 0.0, 0.2, 0.49):
                above = point + np.asarray([*(share * layout.width * side), 0.03])
                assert row.floor(above) == pytest.approx(point[2], abs=1e-6)


def test_the_tool_touches_walls_and_floor_with_the_friction_of_its_maze_and_nothing_else(env: PandaMazeEnv) -> None:
    for model, layout in zip(models_of(env), LAYOUTS, strict=True):
        np.testing.assert_allclose(model.pair_friction[:, :2], layout.friction, rtol=bound(0.0, SPACING))
        stem = model.geom("stem")
        pairs = [set(pair) for pair in zip(model.pair_geom1, model.pair_geom2, strict=True)]
        assert sorted(map(sorted, pairs)) == sorted(sorted((piece, stem.id)) for piece in pieces(model))
        touched = (model.geom_contype & stem.conaffinity[0]) | (model.geom_conaffinity & stem.contype[0])
        assert not touched.any()


def test_all_mazes_are_one_compiled_model_with_different_numbers(env: PandaMazeEnv) -> None:
    first, *others = models_of(env)
    for model in others:
        for name in ("nq", "nv", "ngeom", "npair", "nsensordata"):
            assert getattr(model, name) == getattr(first, name)
        assert not np.array_equal(model.geom_pos, first.geom_pos)


def test_a_new_maze_leaves_nothing_of_the_previous_one_in_the_model() -> None:
    used = PandaMazeEnv.of([paper_layout(), LEVEL], 1, **FAST)
    for _ in range(2):
        used.reset()
    new = PandaMazeEnv.of([LEVEL], **FAST)
    new.reset()
    model, fresh = model_of(used, 0), model_of(new, 0)
    for name in ("geom_pos", "geom_quat", "geom_size", "geom_rbound", "geom_aabb", "pair_friction"):
        np.testing.assert_array_equal(getattr(model, name), getattr(fresh, name), err_msg=name)
    assert (model.geom_pos[pieces(model), 2] > -1).sum() == len(build_corridor(LEVEL).faces) + 1


def test_quantities_that_the_compiler_derives_from_a_box_are_updated(env: PandaMazeEnv) -> None:
    for model in models_of(env):
        for i in pieces(model):
            assert model.geom_rbound[i] == pytest.approx(np.linalg.norm(model.geom_size[i]))
            np.testing.assert_array_equal(model.geom_aabb[i], [0, 0, 0, *model.geom_size[i]])


def test_the_inspected_model_has_the_maze_of_its_environment(env: PandaMazeEnv) -> None:
    for row in (1, 0):
        shown, stepped = env.physics(row).model.ptr, model_of(env, row)
        for i in pieces(stepped):
            name = stepped.geom(i).name
            for attribute in ("pos", "quat", "size"):
                drawn, there = getattr(shown.geom(name), attribute), getattr(stepped.geom(name), attribute)
                np.testing.assert_allclose(drawn, there, rtol=bound(0.0, SPACING), err_msg=name)


def test_a_maze_with_more_pieces_than_the_model_is_refused() -> None:
    segments = (Straight(0.1), *(Disc(0.09), Straight(0.1)) * 4)
    corridor = build_corridor(MazeLayout(segments))
    with pytest.raises(ValueError, match=r"the maze has \d+ pieces of wall; expected at most 48\. Shorten it\."):
        boxes_of(corridor)


def test_a_layout_with_more_pieces_than_the_model_is_refused_before_the_first_episode() -> None:
    segments = (Straight(0.1), *(Disc(0.09), Straight(0.1)) * 3)
    with pytest.raises(ValueError, match="pieces of wall"):
        PandaMazeEnv.of([MazeLayout(segments, start=(0.45, -0.35))], **FAST)


# -- contact -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("make", [PandaMazeEnv.straight, PandaMazeEnv.mazes])
def test_the_tool_touches_nothing_at_the_start_of_an_episode(make: Callable[..., PandaMazeEnv]) -> None:
    env = make(32, **FAST)
    assert (env.reset()["wrench"].abs() < 1e-6).all()
    for row in range(32):
        scene = RayScene(env, row)
        assert scene.data.ncon == 0, env.layouts[row]


def test_a_first_straight_without_room_for_the_tool_before_the_turn_is_refused() -> None:
    segments = (Straight(0.025), Turn(1.2), Straight(0.2))
    with pytest.raises(ValueError, match="first"):
        PandaMazeEnv.of([MazeLayout(segments, start=(0.50, -0.10))], **FAST)


def test_the_tool_starts_just_above_the_floor(env: PandaMazeEnv) -> None:
    for row, layout in enumerate(LAYOUTS):
        if walk(layout)[0][0].rise == 0:
            scene = RayScene(env, row)
            assert scene.data.site("end_effector").xpos[2] - layout.height == pytest.approx(5e-4, abs=1e-4)


def test_a_tool_that_slides_over_a_level_floor_measures_a_steady_force() -> None:
    """A stiff contact lets it hop with the time step: lightly pressed on, it would be in the air nine steps of ten."""
    pressing, lightly = 0.007, 0.002
    straight_on = MazeRandomisation(along=(0.03, 0.03), across=(0.0, 0.0))
    env = PandaMazeEnv.of([LEVEL] * 2, randomisation=straight_on, **FAST)
    force = drag(env, 0.08, [pressing, lightly], 0.9)["wrench"][40:, :, 2].double()
    expected = 250.0 * torch.tensor([pressing, lightly], dtype=torch.float64)
    assert_close(-force.mean(0), expected, rtol=0.3, atol=0)
    assert float(force[:, 0].std()) < 0.05 * float(-force[:, 0].mean())
    assert float(force[:, 1].max()) < -0.2 * float(expected[1])
