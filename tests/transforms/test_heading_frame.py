from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from tensordict import TensorDictBase
from torch import Tensor
from torch.testing import assert_close
from torchrl.envs import TransformedEnv

from ppt_rl.envs import PandaMazeEnv
from ppt_rl.functional import WallTouch
from ppt_rl.functional.heading import from_heading, to_heading
from ppt_rl.tasks.maze.config import maze_space
from ppt_rl.tasks.maze.follower import WallFollower
from ppt_rl.transforms import HeadingFrameTransform
from tests.engines import COARSE
from tests.sampling import normal
from tests.transforms.cases import sliding_env
from tests.transforms.mocks import ScriptedEnv, play

F64 = torch.float64
ROWS, STEPS = 3, 12
EXACT: dict[str, Any] = {"rtol": 0.0, "atol": 1e-12}
NUMBERS = ("distance", "patience", "smoothing", "dt")


def scripted(twist: Tensor, wrench: Tensor, start: Tensor, **kwargs: Any) -> TransformedEnv:
    """An environment that tells twists and wrenches ``(B, T + 1, 6)`` and a start heading ``(B, 1)``."""
    begin = start.unsqueeze(1).expand(-1, twist.shape[1], -1)
    base = ScriptedEnv(1, twist=twist, wrench=wrench, start_heading=begin)
    return TransformedEnv(base, HeadingFrameTransform(**{"dt": 0.01, **kwargs}))


def drawn(seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """Twists, wrenches and start headings of no pattern."""
    twist, wrench = 0.05 * normal(ROWS, STEPS + 1, 6, seed=seed), 3.0 * normal(ROWS, STEPS + 1, 6, seed=seed + 1)
    return twist, wrench, normal(ROWS, 1, seed=seed + 2)


def watch(env: TransformedEnv, steps: int = STEPS) -> TensorDictBase:
    return play(env, torch.zeros(steps, *env.batch_size, 1, dtype=F64))


def steady(
    velocity: tuple[float, float], force: tuple[float, float], steps: int, start: float, **kwargs: Any
) -> TensorDictBase:
    """One row that moves and presses in the same way all the time."""
    twist, wrench = torch.zeros(2, 1, steps + 1, 6, dtype=F64)
    twist[..., :2], wrench[..., :2] = torch.tensor(velocity, dtype=F64), torch.tensor(force, dtype=F64)
    return watch(scripted(twist, wrench, torch.full((1, 1), start, dtype=F64), **kwargs), steps)["next"]


def unwrapped(angle: Tensor) -> Tensor:
    return torch.atan2(angle.sin(), angle.cos())


# -- laws --------------------------------------------------------------------------------------------------------------


def test_an_episode_begins_at_the_heading_that_is_told_with_the_measured_wrench() -> None:
    twist, wrench, start = drawn()
    root = scripted(twist, wrench, start).reset()
    assert torch.equal(root["heading"], start)
    assert torch.equal(root["smooth_wrench"], wrench[:, 0])
    assert torch.equal(root["heading_twist"], to_heading(twist[:, 0], start))
    assert torch.equal(root["heading_wrench"], to_heading(wrench[:, 0], start))


def test_what_is_written_along_the_heading_is_twist_and_smooth_wrench_turned_at_every_step() -> None:
    steps = watch(scripted(*drawn()))["next"]
    assert ((steps["heading"][:, -1] - steps["heading"][:, 0]).abs() > 1e-3).all()
    assert_close(from_heading(steps["heading_twist"], steps["heading"]), steps["twist"], **EXACT)
    assert_close(from_heading(steps["heading_wrench"], steps["heading"]), steps["smooth_wrench"], **EXACT)


@pytest.mark.parametrize("angle", [-2.2, 0.4, math.pi])
def test_a_turn_of_the_world_turns_the_heading_and_leaves_what_is_seen_along_it(angle: float) -> None:
    twist, wrench, start = drawn()
    turn = torch.full((ROWS, 1, 1), angle, dtype=F64)
    here = watch(scripted(twist, wrench, start))["next"]
    there = watch(scripted(from_heading(twist, turn), from_heading(wrench, turn), start + angle))["next"]
    assert_close(there["heading_twist"], here["heading_twist"], **EXACT)
    assert_close(there["heading_wrench"], here["heading_wrench"], **EXACT)
    assert_close(unwrapped(there["heading"] - here["heading"] - angle), 0 * here["heading"], **EXACT)


def test_the_wrench_passes_a_low_pass_of_first_order() -> None:
    wrench = torch.cat([torch.zeros(1, 1, 6), torch.ones(1, STEPS, 6)], 1).double()
    env = scripted(torch.zeros_like(wrench), wrench, torch.zeros(1, 1, dtype=F64), smoothing=0.04, dt=0.01)
    rest = 0.8 ** torch.arange(1, STEPS + 1, dtype=F64)  # 0.04 / (0.04 + 0.01)
    assert_close(watch(env)["next", "smooth_wrench"], (1 - rest).reshape(1, STEPS, 1).expand(1, STEPS, 6), **EXACT)


@pytest.mark.parametrize("start", [-1.2, 1.0])
def test_a_tool_that_keeps_sliding_one_way_sees_itself_go_straight_ahead(start: float) -> None:
    speed = 0.2
    steps = steady((speed * math.cos(0.3), speed * math.sin(0.3)), (0.0, 0.0), 110, start)
    expected = torch.tensor((speed, 0.0, 0.0, 0.0, 0.0, 0.0), dtype=F64)
    assert_close(steps["heading_twist"][0, -1], expected, rtol=0.0, atol=1e-4)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_tool_held_up_by_a_wall_turns_along_it(side: float) -> None:
    normal_force, friction = 4.0, 0.25  # the wall runs along x, and the tool strives half against it
    steps = steady((0.0, 0.0), (friction * normal_force, side * normal_force), 60, side * 1.0, patience=0.1)
    heading = steps["heading"][0, :, 0].abs()
    assert (heading.diff() < 0).all()
    assert heading[-1] < 0.01


@pytest.mark.parametrize(("on", "turns"), [(1.0, False), (0.8, True)])
def test_a_tool_that_stands_turns_along_a_wall_only_if_the_force_on_it_is_large_enough(on: float, turns: bool) -> None:
    heading = steady((0.0, 0.0), (0.2, 0.9), 50, 1.0, touch=WallTouch(on=on))["heading"]
    assert bool((heading - 1.0).abs().max() > 0.1) == turns
    if not turns:
        assert_close(heading, torch.ones_like(heading), **EXACT)


# -- state -------------------------------------------------------------------------------------------------------------


def test_a_partial_reset_begins_anew_only_in_its_rows() -> None:
    twist, wrench, start = drawn()
    env = scripted(twist, wrench, start)
    last = env._step_mdp(watch(env, 4)[:, -1])
    last["_reset"] = torch.tensor([[False], [True], [False]])
    root = env.reset(last.clone())
    for key, first in (("heading", start), ("smooth_wrench", wrench[:, 0])):
        assert torch.equal(root[key][1], first[1])
        assert torch.equal(root[key][[0, 2]], last[key][[0, 2]])
        assert not torch.equal(last[key], first)


def test_rows_outside_the_step_mask_keep_heading_and_smooth_wrench_and_the_others_go_on() -> None:
    env = scripted(*drawn())
    root = env._step_mdp(watch(env, 2)[:, -1]).set("action", torch.zeros(ROWS, 1, dtype=F64))
    full = env.step(root.clone())["next"]
    masked = env.step(root.clone().set("_step", torch.tensor([True, False, True])))["next"]
    for key in ("heading", "smooth_wrench"):
        assert torch.equal(masked[key][1], root[key][1])
        assert torch.equal(masked[key][[0, 2]], full[key][[0, 2]])
        assert not torch.equal(full[key][1], root[key][1])


# -- errors ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("key", ["twist", "wrench", "start_heading"])
def test_a_missing_observation_is_named_with_what_there_is(key: str) -> None:
    twist, wrench, start = drawn()
    script = {"twist": twist, "wrench": wrench, "start_heading": start.unsqueeze(1).expand(-1, STEPS + 1, -1)}
    td = ScriptedEnv(1, **script).reset().exclude(key)
    with pytest.raises(KeyError, match=rf"HeadingFrameTransform needs \['{key}'\]; .*holds .*count"):
        HeadingFrameTransform()._step(td, td)


@pytest.mark.parametrize("name", NUMBERS)
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_a_number_that_is_not_positive_is_refused_by_name(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=rf"{name} is {value}; expected a finite number above 0"):
        HeadingFrameTransform(**{name: value})


# -- the simulated arm -------------------------------------------------------------------------------------------------


def test_in_a_corridor_the_heading_turns_from_the_one_that_is_told_to_that_of_the_corridor() -> None:
    env = sliding_env(PandaMazeEnv.straight(2, seed=3, duration=2.0, engine=COARSE))
    steps = env.rollout(175, WallFollower(maze_space()), break_when_any_done=False)
    off = unwrapped(steps["heading"] - steps["corridor_heading"]).abs()
    assert off[:, 0].min() > 0.3
    assert off[:, -1].max() < 0.12
