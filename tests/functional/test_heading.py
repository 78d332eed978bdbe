from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from ppt_rl.functional.heading import follow_heading, from_heading, to_heading
from tests.sampling import normal

F64 = torch.float64
TIGHT: dict[str, Any] = {"rtol": 0.0, "atol": 1e-12}
ANGLE = 2.0 * normal(40, 1)
LAW: dict[str, Any] = {"dt": 0.01, "distance": 0.02, "patience": 0.3, "slow": 0.01}
each_size = pytest.mark.parametrize("size", [3, 6])


def about_z(angle: Tensor) -> Tensor:
    """Rotation matrices ``(*B, 3, 3)`` about the z axis by angles ``(*B, 1)``."""
    cos, sin, zero = angle[..., 0].cos(), angle[..., 0].sin(), torch.zeros_like(angle[..., 0])
    rows = [(cos, -sin, zero), (sin, cos, zero), (zero, zero, zero + 1)]
    return torch.stack([torch.stack(row, -1) for row in rows], -2)


def turned(vector: Tensor, angle: Tensor) -> Tensor:
    """Vectors ``(*B, 2)`` on the map, rotated counter-clockwise."""
    return (about_z(angle)[..., :2, :2] @ vector.unsqueeze(-1)).squeeze(-1)


def pointing(angle: Tensor) -> Tensor:
    return torch.cat([angle.cos(), angle.sin()], -1)


def followed(heading: Tensor, velocity: Tensor, steps: int = 1, wall: Tensor | None = None, **law: Any) -> Tensor:
    """Heading after some steps at a constant velocity, along the tangent of a wall if one is given."""
    tangent = torch.zeros_like(velocity) if wall is None else wall
    touching = torch.full_like(heading, wall is not None, dtype=torch.bool)
    for _ in range(steps):
        heading = follow_heading(heading, velocity, tangent, touching, **{**LAW, **law})
    return heading


def assert_same_direction(one: Tensor, other: Tensor, atol: float = 1e-12) -> None:
    assert_close(pointing(one), pointing(other), rtol=0.0, atol=atol)


# -- axes --------------------------------------------------------------------------------------------------------------


@each_size
def test_to_heading_and_from_heading_are_inverse_to_each_other(size: int) -> None:
    vector = normal(40, size, seed=1)
    assert_close(from_heading(to_heading(vector, ANGLE), ANGLE), vector, **TIGHT)
    assert_close(to_heading(from_heading(vector, ANGLE), ANGLE), vector, **TIGHT)


@each_size
def test_both_rotations_keep_the_norm_and_the_height_of_each_half(size: int) -> None:
    vector = normal(40, size, seed=1)
    for turn in (to_heading, from_heading):
        before, after = vector.unflatten(-1, (-1, 3)), turn(vector, ANGLE).unflatten(-1, (-1, 3))
        assert_close(after.norm(dim=-1), before.norm(dim=-1), **TIGHT)
        assert torch.equal(after[..., 2], before[..., 2])


@each_size
def test_from_heading_is_the_rotation_matrix_about_z_on_each_half_and_to_heading_its_transpose(size: int) -> None:
    vector, matrix = normal(40, size, seed=1), about_z(ANGLE)
    halves = vector.unflatten(-1, (-1, 3))
    assert_close(from_heading(vector, ANGLE), torch.einsum("bij,bhj->bhi", matrix, halves).flatten(-2), **TIGHT)
    assert_close(to_heading(vector, ANGLE), torch.einsum("bji,bhj->bhi", matrix, halves).flatten(-2), **TIGHT)


def test_the_direction_of_the_heading_becomes_x_and_its_left_becomes_y() -> None:
    zero = torch.zeros_like(ANGLE)
    ahead = torch.cat([pointing(ANGLE), zero], -1)
    left = torch.cat([pointing(ANGLE + math.pi / 2), zero], -1)
    x, y, _ = torch.eye(3, dtype=F64).expand(40, 3, 3).unbind(-2)
    assert_close(to_heading(ahead, ANGLE), x, **TIGHT)
    assert_close(to_heading(left, ANGLE), y, **TIGHT)


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_the_output_has_the_precision_of_the_input(dtype: torch.dtype) -> None:
    angle, velocity = ANGLE.to(dtype), normal(40, 2).to(dtype)
    assert to_heading(normal(40, 3).to(dtype), angle).dtype == dtype
    assert from_heading(normal(40, 6).to(dtype), angle).dtype == dtype
    assert followed(angle, velocity, wall=velocity).dtype == dtype


@pytest.mark.parametrize("size", [1, 2, 4, 5, 7])
@pytest.mark.parametrize("turn", [to_heading, from_heading])
def test_a_vector_with_neither_three_nor_six_components_is_refused_with_its_shape(turn: Callable, size: int) -> None:
    with pytest.raises(ValueError, match=rf"vector has shape \(40, {size}\); expected \(\*batch, 3\) or"):
        turn(normal(40, size), ANGLE)


# -- the law -----------------------------------------------------------------------------------------------------------


def test_a_tool_at_rest_without_contact_keeps_its_heading() -> None:
    assert_same_direction(followed(ANGLE, torch.zeros(40, 2, dtype=F64), steps=50), ANGLE)


def test_a_tool_that_slides_straight_ahead_keeps_its_heading_with_and_without_a_wall() -> None:
    velocity = 0.05 * pointing(ANGLE)
    assert_same_direction(followed(ANGLE, velocity, steps=50), ANGLE)
    assert_same_direction(followed(ANGLE, velocity, steps=50, wall=pointing(ANGLE)), ANGLE)


def test_backward_motion_does_not_turn_the_heading() -> None:
    off = math.pi / 2 + 0.01 + (math.pi - 0.02) * torch.rand(40, 1, dtype=F64)
    assert_same_direction(followed(ANGLE, 0.1 * pointing(ANGLE + off), steps=20), ANGLE)


@pytest.mark.parametrize("steps", [1, 20, 200])
def test_the_tangent_of_the_angle_to_the_motion_decays_exponentially_with_the_distance_travelled(steps: int) -> None:
    start, speed, dt = torch.linspace(-1.4, 1.4, 14, dtype=F64).unsqueeze(-1), 0.05, 0.001
    motion = torch.full_like(start, 0.3)
    reached = followed(motion + start, speed * pointing(motion), steps=steps, dt=dt) - motion
    travelled = speed * dt * steps
    assert_close(reached.tan() / start.tan(), torch.full_like(start, math.exp(-travelled / 0.02)), rtol=2e-2, atol=1e-3)


def test_after_many_distances_the_heading_is_the_direction_of_motion() -> None:
    turn = 1.4 * torch.rand(40, 1, dtype=F64)
    assert_same_direction(followed(ANGLE, 0.5 * pointing(ANGLE + turn), steps=100), ANGLE + turn, atol=1e-6)


def test_half_the_speed_for_twice_the_time_turns_the_heading_equally() -> None:
    motion, off = ANGLE, 0.8
    fast = followed(ANGLE + off, 0.04 * pointing(motion), steps=50)
    slow = followed(ANGLE + off, 0.02 * pointing(motion), steps=100)
    assert_close(pointing(slow), pointing(fast), rtol=0.0, atol=5e-3)
    assert (pointing(fast) - pointing(ANGLE + off)).norm(dim=-1).min() > 0.3
    longer = followed(ANGLE + off, 0.02 * pointing(motion), steps=50, dt=2 * LAW["dt"])
    assert_same_direction(longer, fast)


@pytest.mark.parametrize("seed", range(3))
def test_rotating_the_world_rotates_the_heading(seed: int) -> None:
    velocity, tangent = 0.03 * normal(40, 2, seed=seed), pointing(normal(40, 1, seed=seed + 7))
    touching, angle = normal(40, 1, seed=seed + 3) > 0, 3.0 * normal(40, 1, seed=seed + 5)
    here = follow_heading(ANGLE, velocity, tangent, touching, **LAW)
    there = follow_heading(ANGLE + angle, turned(velocity, angle), turned(tangent, angle), touching, **LAW)
    assert_same_direction(there, here + angle)


def test_mirroring_the_world_mirrors_the_heading() -> None:
    velocity, tangent, mirror = 0.03 * normal(40, 2), pointing(normal(40, 1)), torch.tensor((1.0, -1.0), dtype=F64)
    here = followed(ANGLE, velocity, wall=tangent)
    assert_same_direction(followed(-ANGLE, velocity * mirror, wall=tangent * mirror), -here)


def test_a_stuck_tool_turns_along_the_wall_within_the_patience() -> None:
    start = torch.linspace(-2.5, 2.5, 15, dtype=F64).unsqueeze(-1)
    still, along = torch.zeros(15, 2, dtype=F64), torch.full_like(start, 0.4)
    for time in (0.1, 0.3, 1.2):
        reached = followed(along + start, still, steps=round(time / 0.002), wall=pointing(along), dt=0.002) - along
        expected = 2 * torch.atan((start / 2).tan() * math.exp(-time / LAW["patience"]))
        assert_close(reached, expected, rtol=0.0, atol=1e-2)


def test_a_wall_turns_the_heading_only_where_it_is_touched() -> None:
    still, tangent = torch.zeros(40, 2, dtype=F64), pointing(ANGLE + 1.0)
    touching = torch.arange(40).unsqueeze(-1) % 2 == 0
    reached = follow_heading(ANGLE, still, tangent, touching, **LAW)
    moved = (pointing(reached) - pointing(ANGLE)).norm(dim=-1, keepdim=True) > 1e-3
    assert torch.equal(moved, touching)
    assert_same_direction(reached[1::2], ANGLE[1::2])


def test_the_faster_the_tool_slides_the_less_the_wall_turns_it() -> None:
    speeds = torch.tensor([[0.0], [0.01], [0.05], [0.5]], dtype=F64)
    ahead = torch.zeros(4, 1, dtype=F64)
    reached = followed(ahead, -speeds * pointing(ahead), wall=pointing(ahead + 1.0))  # backward: only the wall turns it
    assert (reached.diff(dim=0) < 0).all()
    assert reached[1] / reached[0] == pytest.approx(0.5, rel=0.02)
    assert reached[3] < 1e-3 * reached[0]


def test_headings_lie_between_minus_pi_and_pi() -> None:
    reached = followed(10.0 * ANGLE, 0.05 * normal(40, 2))
    assert (reached.abs() <= math.pi).all()
