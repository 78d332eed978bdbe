from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from tensordict import TensorDictBase
from torch import Tensor
from torch.testing import assert_close
from torchrl.envs import TransformedEnv

from ppt_rl.functional import ViaPointConfig, WallTouch
from ppt_rl.functional.heading import from_heading
from ppt_rl.transforms import ContactViaPointTransform
from tests.sampling import normal, random_poses
from tests.transforms.mocks import ScriptedEnv, play

DURATION, LOOKAHEAD, SPACING, DT = 0.8, 0.3, 0.05, 0.01
SPEED, OFFSET, STD = 0.08, 0.002, (0.02, 0.003, 0.01)
ALIVE, EVERY = round(LOOKAHEAD / DT), round(SPACING / DT)  # [control steps]
FRICTION = 0.25
EXACT: dict[str, Any] = {"rtol": 0.0, "atol": 1e-9}
STATE = (
    "contact", "new_wall", "via_mask", "via_wait", "via_pause", "via_phase", "via_tangent", "via_position", "via_cov",
)  # fmt: skip


def make_transform(*, duration: float = DURATION, dt: float = DT, **kwargs: Any) -> ContactViaPointTransform:
    """The transform with the numbers of its two configs by name."""
    touch = {key: kwargs.pop(key) for key in ("friction", "slow", "on", "off") if key in kwargs}
    given: dict[str, Any] = {"lookahead": LOOKAHEAD, "spacing": SPACING, "speed": SPEED, "offset": OFFSET, "std": STD}
    config = ViaPointConfig(**{**given, **kwargs})
    return ContactViaPointTransform(duration, config, WallTouch(**{"friction": FRICTION, **touch}), dt=dt)


def wall_force(size: Tensor, way: Tensor, side: float = 1.0) -> Tensor:
    """Wrenches on a wall along angles ``way`` to the left or right, with friction, of normal forces ``size``."""
    zero = torch.zeros_like(size)
    return from_heading(torch.cat([FRICTION * size, side * size, zero, zero, zero, zero], -1), way)


def scripted(
    force: Tensor, way: Tensor, *, side: float = 1.0, poses: Tensor | None = None, **kwargs: Any
) -> TransformedEnv:
    """A tool held up by walls along angles ``(B, 1)`` or ``(B, T + 1, 1)``, pressed on by forces ``(B, T + 1)``."""
    rows, steps = force.shape
    angle = way if way.ndim == 3 else way.unsqueeze(1).expand(rows, steps, 1)
    wrench = wall_force(force.unsqueeze(-1), angle, side)
    poses = random_poses(rows, steps) if poses is None else poses
    script = {"pose": poses, "twist": torch.zeros_like(wrench), "smooth_wrench": wrench, "heading": angle}
    script = {key: value.to(force.dtype) for key, value in script.items()}
    return TransformedEnv(ScriptedEnv(1, **script), make_transform(**kwargs))


def watch(env: TransformedEnv, steps: int) -> TensorDictBase:
    return play(env, torch.zeros(steps, *env.batch_size, 1, dtype=env.base_env.dtype))["next"]


def pressed(steps: int, rows: int = 1) -> Tensor:
    return torch.full((rows, steps + 1), 4.0, dtype=torch.float64)


def ways(rows: int = 1) -> Tensor:
    return 2.0 * normal(rows, 1)


# -- when --------------------------------------------------------------------------------------------------------------


def test_without_contact_there_is_never_a_via_point() -> None:
    steps = watch(scripted(0.1 * pressed(40), ways()), 40)
    assert not steps["contact"].any()
    assert not steps["via_mask"].any()


def test_a_buffer_begins_empty_even_where_the_tool_is_pressed_on_a_wall() -> None:
    root = scripted(pressed(5), ways()).reset()
    assert not root["contact"].any()
    assert not root["via_mask"].any()


def test_in_contact_there_is_one_more_via_point_every_spacing_until_the_first_is_due() -> None:
    steps = watch(scripted(pressed(100), ways(), capacity=20), 100)
    count = steps["via_mask"].sum(-1)[0]
    expected = torch.arange(100).div(EVERY, rounding_mode="floor") + 1
    assert torch.equal(count[: ALIVE - 1], expected[: ALIVE - 1])
    assert count.max() <= ALIVE // EVERY + 1
    assert count[ALIVE:].min() >= ALIVE // EVERY


@pytest.mark.parametrize("capacity", [1, 3])
def test_a_full_buffer_replaces_the_via_point_that_is_due_first(capacity: int) -> None:
    steps = watch(scripted(pressed(60), ways(), capacity=capacity), 60)
    phase, mask = steps["via_phase"][0], steps["via_mask"][0]
    assert mask.shape == (60, capacity)
    assert mask[EVERY * capacity :].all()
    for k in range(EVERY * capacity, 60):
        kept = phase[k - 1] - DT / DURATION
        if k % EVERY == 0:
            kept[phase[k - 1].argmin()] = LOOKAHEAD / DURATION
        assert_close(phase[k], kept, **EXACT)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_via_point_counts_down_to_its_time_and_is_masked_from_then_on(dtype: torch.dtype) -> None:
    force = torch.zeros(1, 51, dtype=dtype)
    force[:, 1] = 4.0  # felt at the first step only
    steps = watch(scripted(force, ways().to(dtype), capacity=2), 50)
    slot = int(steps["via_mask"][0, 0].int().argmax())
    left = (LOOKAHEAD - DT * torch.arange(50, dtype=dtype)).clamp_min(0.0) / DURATION
    assert_close(steps["via_phase"][0, :, slot], left, rtol=0.0, atol=1e-6)
    assert steps["via_mask"][0, :, slot].tolist() == [True] * ALIVE + [False] * (50 - ALIVE)
    assert steps["via_mask"][0].sum(-1).max() == 1


def test_contact_and_so_the_via_points_begin_above_one_force_and_end_below_a_smaller_one() -> None:
    force = torch.tensor([[0.0, 0.7, 1.2, 0.7, 0.6, 0.2, 0.7]], dtype=torch.float64)
    steps = watch(scripted(force, ways(), spacing=DT), 6)
    assert steps["contact"].flatten().tolist() == [False, True, True, True, False, False]
    assert steps["via_mask"].sum(-1).flatten().tolist() == [0, 1, 2, 3, 3, 3]


def test_a_wall_is_told_to_be_new_in_its_first_step_only_and_not_where_contact_comes_back() -> None:
    force = 4.0 * torch.tensor([[1, 1, 1, 1, 0, 0, 1, 1]], dtype=torch.float64)
    assert watch(scripted(force, ways()), 7)["new_wall"].flatten().tolist() == [True] + 6 * [False]


def turning(turns: list[float]) -> Tensor:
    """Directions ``(1, T + 1, 1)`` of a wall: the first for the reset, then one for every step."""
    return torch.tensor([turns[0], *turns], dtype=torch.float64).reshape(1, -1, 1)


@pytest.mark.parametrize("by", [0.35, -0.35, 3.0])
def test_a_wall_that_has_turned_is_new_and_the_via_points_along_the_old_one_are_forgotten(by: float) -> None:
    steps = watch(scripted(pressed(14), turning([0.0] * 12 + [by] * 2), turn=0.3), 14)
    assert steps["new_wall"].flatten().tolist() == [True] + 11 * [False] + [True, False]
    assert steps["via_mask"].sum(-1).flatten().tolist() == [1] * 5 + [2] * 5 + [3] * 2 + [1] * 2
    along = steps["via_position"][0, -1] - steps["pose"][0, 12, :3]
    way = torch.tensor([math.cos(by), math.sin(by)], dtype=torch.float64)
    offset = OFFSET * torch.tensor([-math.sin(by), math.cos(by)], dtype=torch.float64)
    kept = steps["via_mask"][0, -1]
    assert_close(along[kept][0, :2], SPEED * LOOKAHEAD * way - offset, rtol=0.0, atol=1e-8)


def test_a_wall_that_turns_a_little_is_not_new() -> None:
    steps = watch(scripted(pressed(14), turning([0.0] * 7 + [0.25] * 7), turn=0.3), 14)
    assert steps["new_wall"].sum() == 1
    assert steps["via_mask"].sum(-1).flatten().tolist() == [1] * 5 + [2] * 5 + [3] * 4


def test_walls_in_quick_succession_are_told_after_a_pause_only_but_via_points_are_forgotten_at_once() -> None:
    turns = [0.0] * 4 + [0.5] * 4 + [1.0] * 4
    steps = watch(scripted(pressed(12), turning(turns), pause=0.08), 12)
    assert steps["new_wall"].flatten().nonzero().flatten().tolist() == [0, 8]
    assert steps["via_mask"].sum(-1).flatten().tolist() == [1] * 12


def test_contact_that_comes_back_within_the_spacing_waits_for_the_next_via_point() -> None:
    force = 4.0 * torch.tensor([[0, 1, 0, 1, 1, 1, 1, 1]], dtype=torch.float64)
    steps = watch(scripted(force, ways()), 7)
    assert steps["via_mask"].sum(-1).flatten().tolist() == [1, 1, 1, 1, 1, 2, 2]


# -- where -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["left", "right"])
def test_a_via_point_lies_along_the_wall_a_little_off_it_with_the_accuracies_of_these_directions(side: float) -> None:
    way, poses = ways(5), random_poses(5, 2)
    step = watch(scripted(pressed(1, 5), way, side=side, poses=poses, capacity=1), 1)[:, 0]
    zero = torch.zeros_like(way)
    tangent = torch.cat([way.cos(), way.sin(), zero], -1)
    across = side * torch.cat([-way.sin(), way.cos(), zero], -1)
    up = torch.cat([zero, zero, zero + 1], -1)
    expected = poses[:, 1, :3] + SPEED * LOOKAHEAD * tangent - OFFSET * across
    assert_close(step["via_position"][:, 0], expected, rtol=0.0, atol=1e-8)
    cov = step["via_cov"][:, 0]
    assert_close(cov, cov.mT, rtol=0.0, atol=1e-15)
    for axis, std in zip((tangent, across, up), STD, strict=True):
        assert_close((cov @ axis.unsqueeze(-1)).squeeze(-1), std**2 * axis, rtol=0.0, atol=1e-10)


@pytest.mark.parametrize("angle", [-2.2, 0.4, math.pi])
def test_a_turn_of_the_world_turns_the_via_points(angle: float) -> None:
    way, poses = ways(3), random_poses(3, 13)
    turn = torch.full((3, 1, 1), angle, dtype=torch.float64)
    moved = torch.cat([from_heading(poses[..., :3], turn), poses[..., 3:]], -1)
    here = watch(scripted(pressed(12, 3), way, poses=poses), 12)
    there = watch(scripted(pressed(12, 3), way + angle, poses=moved), 12)
    used = here["via_mask"]
    assert torch.equal(there["via_mask"], used)
    assert used.any()
    turn = turn.unsqueeze(-1)
    assert_close(there["via_position"], from_heading(here["via_position"], turn), **EXACT)
    once = from_heading(here["via_cov"], turn.unsqueeze(-1))
    assert_close(there["via_cov"][used], from_heading(once.mT, turn.unsqueeze(-1))[used], **EXACT)


def test_a_via_point_stays_in_the_world_while_the_tool_goes_on() -> None:
    steps = watch(scripted(pressed(EVERY), ways(), capacity=1), EVERY)
    position = steps["via_position"][0, :, 0]
    assert_close(position, position[:1].expand(EVERY, 3), rtol=0.0, atol=0.0)
    assert (steps["pose"][0, :, :3].diff(dim=0).abs() > 1e-4).all()


# -- state -------------------------------------------------------------------------------------------------------------


def test_a_partial_reset_empties_the_buffer_only_in_its_rows() -> None:
    env = scripted(pressed(20, 3), ways(3))
    last = env._step_mdp(play(env, torch.zeros(8, 3, 1, dtype=torch.float64))[:, -1])
    assert last["via_mask"].any(-1).all()
    last["_reset"] = torch.tensor([[False], [True], [False]])
    root = env.reset(last.clone())
    for key in STATE:
        assert torch.equal(root[key][[0, 2]], last[key][[0, 2]])
    for key in ("contact", "new_wall", "via_mask", "via_wait", "via_pause", "via_phase", "via_tangent"):
        assert not root[key][1].any()


def test_rows_outside_the_step_mask_keep_their_buffer_and_the_others_go_on() -> None:
    env = scripted(pressed(20, 3), ways(3))
    root = env._step_mdp(play(env, torch.zeros(EVERY, 3, 1, dtype=torch.float64))[:, -1])
    root["action"] = torch.zeros(3, 1, dtype=torch.float64)
    full = env.step(root.clone())["next"]
    masked = env.step(root.clone().set("_step", torch.tensor([True, False, True])))["next"]
    assert (full["via_mask"].sum(-1) == root["via_mask"].sum(-1) + 1).all()
    for key in STATE:
        assert torch.equal(masked[key][1], root[key][1])
        assert torch.equal(masked[key][[0, 2]], full[key][[0, 2]])


# -- errors ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("key", ["pose", "twist", "smooth_wrench", "heading"])
def test_a_missing_observation_is_named_with_who_writes_it(key: str) -> None:
    td = scripted(pressed(1), ways()).base_env.reset().exclude(key)
    with pytest.raises(KeyError, match=rf"ContactViaPointTransform needs \['{key}'\]; .*HeadingFrameTransform writes"):
        make_transform()._step(td, td)


@pytest.mark.parametrize("name", ["duration", "lookahead", "speed", "spacing", "pause", "friction", "slow", "dt"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan")])
def test_a_number_that_is_not_positive_is_refused_by_name(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=rf"{name} is {value}; expected a finite number above 0"):
        make_transform(**{name: value})


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"lookahead": 0.9}, r"lookahead is 0\.9 s; expected at most the primitive's duration, 0\.8 s"),
        ({"turn": 0.0}, r"turn is 0\.0 rad; expected a number above 0 and below pi"),
        ({"turn": 3.2}, r"turn is 3\.2 rad"),
        ({"capacity": 0}, "capacity is 0; expected a whole number from 1 to"),
        ({"on": 0.4, "off": 0.5}, r"on and off are 0\.4 and 0\.5 N; expected on >= off > 0"),
        ({"off": 0.0}, r"on and off are 1\.0 and 0\.0 N"),
        ({"offset": -0.001}, r"offset is -0\.001; expected a finite number of at least 0 m"),
        ({"std": (0.02, 0.0, 0.02)}, r"std is 0\.0; expected a finite number above 0 m"),
    ],
)
def test_numbers_out_of_range_are_refused_with_what_came(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_transform(**given)


@pytest.mark.parametrize("std", [(0.02,), (0.02, 0.003), (0.02,) * 4])
def test_another_number_of_accuracies_than_three_is_refused(std: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="std"):
        make_transform(std=std)
