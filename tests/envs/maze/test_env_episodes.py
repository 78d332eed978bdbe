"""How episodes of the maze environment start and end."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from ppt_rl.envs import MazeLayout, MazeRandomisation, PandaMazeEnv
from ppt_rl.envs.maze.geometry import build_corridor
from tests.engines import COARSE, model_of, models_of
from tests.envs.maze.mazes import LEVEL, drag, layouts_of, put_tool, unit
from tests.envs.scenes import act, leaves, rollout, torques

F64 = torch.float64
FAST: dict[str, Any] = {"engine": COARSE, "seed": 0}
Make = Callable[..., PandaMazeEnv]


def column(value: Tensor) -> list[Any]:
    return value.squeeze(-1).tolist()


def at(layout: MazeLayout, along: float, aside: float = 0.0, above: float = 5e-4) -> np.ndarray:
    """A position in a straight corridor: from its closed end, to the left of its centre line, above its floor."""
    offset = along * unit(layout.heading) + aside * unit(layout.heading + 0.5 * math.pi)
    return np.asarray([*(layout.start + offset), layout.height + above])


# -- the start of an episode -------------------------------------------------------------------------------------------


def test_the_tool_starts_upright_and_within_the_ranges_of_its_start() -> None:
    env = PandaMazeEnv.straight(64, dtype=F64, **FAST)
    observation, ranges = env.reset(), MazeRandomisation()
    length = torch.tensor([build_corridor(layout).length for layout in layouts_of(env)], dtype=F64)
    room = torch.tensor([0.5 * layout.width - env.tool.stem_radius for layout in layouts_of(env)], dtype=F64)
    drawn = {
        "along": observation["progress"].squeeze(-1) * length,
        "across": observation["corridor_offset"].squeeze(-1) / room,
    }
    for name, values in drawn.items():
        low, high = getattr(ranges, name)
        margin = 0.1 * (high - low)
        assert low - 0.05 * margin <= float(values.min()) < low + margin, name
        assert high + 0.05 * margin >= float(values.max()) > high - margin, name
    upright = torch.tensor(env.start_pose[3:], dtype=F64).expand(64, 4)
    assert_close((observation["pose"][:, 3:] * upright).sum(-1).abs(), torch.ones(64, dtype=F64), rtol=0, atol=1e-6)
    floor = torch.tensor([layout.height for layout in layouts_of(env)], dtype=F64)
    assert_close(observation["pose"][:, 2] - floor, torch.full((64,), 5e-4, dtype=F64), rtol=0, atol=1e-4)


@pytest.mark.parametrize(("make", "error"), [(PandaMazeEnv.straight, 0.9), (PandaMazeEnv.mazes, 0.2)])
def test_the_told_heading_has_an_error_in_its_range_that_is_constant_in_an_episode(make: Make, error: float) -> None:
    env = make(24, duration=0.02, **FAST)
    told = rollout(env, torch.zeros(24, 2, 7))["start_heading"]
    off = told[:, 0, 0] - torch.tensor([layout.heading for layout in layouts_of(env)])
    assert torch.equal(told[:, 0], told[:, 1])
    assert float(off.abs().max()) <= error + 1e-6
    assert float(off.max()) > 0.6 * error
    assert float(off.min()) < -0.6 * error


def test_a_partial_reset_draws_mazes_for_its_environments_and_leaves_the_others_alone() -> None:
    env = PandaMazeEnv.mazes(4, **FAST)
    before = act(env, env.reset(), torques(env, 1)[:, 0])
    kept, layouts = before.clone(), layouts_of(env)
    geometry = [model.geom_pos for model in models_of(env)]
    states = [env.engine.state(row) for row in range(4)]
    mask = torch.tensor([True, False, False, True])
    after = env.reset(before.copy().set("_reset", mask.unsqueeze(-1)))
    for key in ("start_heading", "corridor_heading", "corridor_offset", "progress", "pose"):
        same = (after[key] == before[key]).flatten(1).all(-1)
        assert torch.equal(same, ~mask), key
    for row, drawn in enumerate(mask.tolist()):
        assert (layouts_of(env)[row] != layouts[row]) is drawn
        assert np.array_equal(model_of(env, row).geom_pos, geometry[row]) is not drawn
        assert np.array_equal(env.engine.state(row), states[row]) is not drawn
    act(env, after)
    assert all(torch.equal(leaves(before)[name], value) for name, value in leaves(kept).items())


# -- the end of an episode ---------------------------------------------------------------------------------------------


def test_success_is_the_end_of_the_centre_line_reached_inside_the_corridor() -> None:
    env = PandaMazeEnv.of([LEVEL] * 4, max_force=1e9, **FAST)
    observation = env.reset()
    for row, (along, above) in enumerate([(0.39, 5e-4), (0.402, 5e-4), (0.2, 5e-4), (0.402, 0.045)]):
        put_tool(env, row, at(LEVEL, along, above=above))
    after = act(env, observation)
    assert column(after["success"]) == [False, True, False, False]
    assert column(after["terminated"]) == column(after["done"]) == [False, True, False, True]
    assert column(after["progress"]) == pytest.approx([0.39 / 0.4, 1.0, 0.5, 1.0], abs=1e-3)
    assert not after["truncated"].any()
    assert after["reward_terms", "progress"][1] > env.rewards.success


def test_a_tool_beyond_a_wall_or_lifted_over_the_walls_has_left_the_corridor() -> None:
    env = PandaMazeEnv.of([LEVEL] * 6, max_force=1e9, **FAST)
    observation = env.reset()
    cases = [(0.0, 5e-4), (0.014, 5e-4), (0.07, 5e-4), (-0.07, 5e-4), (0.0, 0.039), (0.0, 0.042)]
    for row, (aside, above) in enumerate(cases):
        put_tool(env, row, at(LEVEL, 0.2, aside, above))
    after = act(env, observation)
    expected = [False, False, True, True, False, True]
    assert_close(after["corridor_offset"].squeeze(-1), torch.tensor([a for a, _ in cases]), rtol=0, atol=1e-3)
    for name in ("left_corridor", "terminated", "done"):
        assert column(after[name]) == expected, name
    assert not after["truncated"].any()
    failed = after["reward_terms", "contact"].squeeze(-1) <= -env.rewards.failure
    assert failed.tolist() == expected


def test_a_force_above_the_limit_ends_the_episode_and_one_below_does_not() -> None:
    env = PandaMazeEnv.of([LEVEL], max_force=1.0, dtype=F64, **FAST)
    run = drag(env, 0.05, [0.02], 1.0)[1:, 0]
    assert_close(run["unsafe"], run["wrench"][:, :3].norm(dim=-1, keepdim=True) > 1.0)
    for name in ("unsafe", "terminated", "done"):
        assert column(run[name]) == [False] * (len(run) - 1) + [True], name
    assert len(run) < 100
    assert not run["success"].any()
    assert run["reward_terms", "contact"][-1] <= -env.rewards.failure


def test_an_episode_is_truncated_at_its_horizon() -> None:
    env = PandaMazeEnv.of([LEVEL], duration=0.03, **FAST)
    ends = rollout(env, torch.zeros(1, 6, 7))["next"]
    expected = torch.tensor([False, False, True] * 2)
    assert torch.equal(ends["truncated"][0, :, 0], expected)
    assert torch.equal(ends["done"], ends["truncated"])
    assert not ends["terminated"].any()


def test_a_reset_after_the_end_of_an_episode_starts_a_new_one() -> None:
    env = PandaMazeEnv.of([LEVEL], **FAST)
    observation = env.reset()
    put_tool(env, 0, at(LEVEL, 0.402))
    assert act(env, observation)["success"].all()
    fresh = env.reset()
    assert not fresh["success"].any()
    assert not act(env, fresh)["done"].any()
