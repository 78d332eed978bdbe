from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from ppt_rl.functional.contact import WallContact, WallTouch, is_touching, wall_contact
from tests.sampling import normal

F64 = torch.float64
TIGHT: dict[str, Any] = {"rtol": 0.0, "atol": 1e-10}
SLOW = 0.01
BATCH = 30
ANGLE = 2.0 * normal(BATCH, 1)  # angle of the wall's tangent
each_side = pytest.mark.parametrize("side", [1.0, -1.0], ids=["left", "right"])
each_friction = pytest.mark.parametrize("friction", [0.05, 0.25, 0.6])


def turned(vector: Tensor, angle: Tensor | float) -> Tensor:
    """Vectors rotated counter-clockwise on the map; a third component does not change."""
    angle = torch.as_tensor(angle, dtype=vector.dtype).expand_as(vector[..., :1])
    cos, sin = angle.cos(), angle.sin()
    x, y = vector[..., :1], vector[..., 1:2]
    return torch.cat([cos * x - sin * y, sin * x + cos * y, vector[..., 2:]], -1)


def along() -> Tensor:
    return torch.cat([ANGLE.cos(), ANGLE.sin()], -1)


def across(side: float) -> Tensor:
    """Normals into the wall, which is to the left (+1) or to the right (-1) of the tangent."""
    return turned(along(), side * math.pi / 2)


def slid(side: float, friction: float, press: float = 3.0, floor: float = 0.0, moving: float = 1.0) -> Tensor:
    """Force of a tool that slides or pushes along a wall with Coulomb friction, pressed on wall and floor."""
    on_map = press * across(side) + friction * (press + moving * floor) * along()
    return torch.cat([on_map, torch.full((BATCH, 1), -floor, dtype=F64)], -1)


def drawn(seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """Random forces, velocities and headings."""
    return 3.0 * normal(200, 3, seed=seed), 0.03 * normal(200, 2, seed=seed + 1), 2.0 * normal(200, 1, seed=seed + 2)


def felt(force: Tensor, velocity: Tensor, heading: Tensor, friction: float = 0.25) -> WallContact:
    return wall_contact(force, velocity, heading, friction=friction, slow=SLOW)


def angle_between(one: Tensor, other: Tensor) -> Tensor:
    return torch.atan2(one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0], (one * other).sum(-1)).abs()


# -- hysteresis --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("before", "force", "after"),
    [
        (False, 0.3, False),
        (False, 0.7, False),
        (False, 1.1, True),
        (True, 0.3, False),
        (True, 0.7, True),
        (True, 1.1, True),
    ],
)
def test_contact_begins_above_one_force_ends_below_the_other_and_between_them_stays(
    before: bool, force: float, after: bool
) -> None:
    touching = is_touching(torch.tensor([before]), torch.tensor([force]), on=1.0, off=0.5)
    assert touching.dtype is torch.bool
    assert touching.item() is after


def test_a_force_that_chatters_between_the_thresholds_neither_begins_nor_ends_contact() -> None:
    chatter = 0.75 + 0.24 * (torch.arange(60) % 2 * 2 - 1)
    signal = torch.cat([chatter, torch.tensor([1.2]), chatter, torch.tensor([0.4]), chatter])
    touching, seen = torch.tensor([False]), []
    for force in signal:
        touching = is_touching(touching, force.unsqueeze(0), on=1.0, off=0.5)
        seen.append(touching.item())
    assert seen == [False] * 60 + [True] * 61 + [False] * 61


def test_every_row_of_a_batch_has_its_own_contact() -> None:
    before = torch.tensor([[True], [False], [True], [False]])
    force = torch.tensor([[0.7], [0.7], [0.1], [2.0]], dtype=F64)
    assert is_touching(before, force, on=1.0, off=0.5).flatten().tolist() == [True, False, False, True]


# -- walls with Coulomb friction ---------------------------------------------------------------------------------------


@each_side
@each_friction
@pytest.mark.parametrize("speed", [1e-3, 0.01, 0.06])
def test_a_tool_that_slides_along_a_wall_feels_its_tangent_and_normal(
    side: float, friction: float, speed: float
) -> None:
    wall = felt(slid(side, friction), speed * along(), ANGLE, friction)
    assert_close(wall.tangent, along(), **TIGHT)
    assert_close(wall.normal, across(side), **TIGHT)


@each_side
@each_friction
def test_the_floors_friction_is_subtracted_where_the_tool_slides(side: float, friction: float) -> None:
    velocity = 1e3 * SLOW * along()
    wall = felt(slid(side, friction, floor=4.0), velocity, ANGLE, friction)
    assert_close(wall.force, slid(side, friction)[:, :2], rtol=0.0, atol=4e-3)
    assert_close(wall.tangent, along(), rtol=0.0, atol=1e-5)
    assert_close(wall.normal, across(side), rtol=0.0, atol=1e-5)


@each_side
@pytest.mark.parametrize("off", [-0.6, 0.0, 0.6])
def test_at_the_tasks_speed_tangent_and_normal_are_right_despite_the_floor_and_a_wrong_heading(
    side: float, off: float
) -> None:
    wall = felt(slid(side, 0.25, floor=2.0), 0.06 * along(), ANGLE + off)
    assert angle_between(wall.tangent, along()).max() < 0.02
    assert angle_between(wall.normal, across(side)).max() < 0.02


@each_side
@each_friction
@pytest.mark.parametrize("off", [-0.8, 0.0, 0.9])
def test_a_stuck_tool_finds_the_tangent_from_the_force_if_the_friction_is_known(
    side: float, friction: float, off: float
) -> None:
    still = torch.zeros(BATCH, 2, dtype=F64)
    wall = felt(slid(side, friction), still, ANGLE + side * off, friction)
    assert_close(wall.tangent, along(), **TIGHT)
    assert_close(wall.normal, across(side), **TIGHT)


@each_side
@each_friction
@pytest.mark.parametrize("estimate", [0.01, 0.25, 0.5])
def test_a_wrong_friction_estimate_rotates_the_tangent_by_the_difference_of_the_friction_angles(
    side: float, friction: float, estimate: float
) -> None:
    wall = felt(slid(side, friction), torch.zeros(BATCH, 2, dtype=F64), ANGLE, estimate)
    off = abs(math.atan(friction) - math.atan(estimate))
    assert_close(angle_between(wall.tangent, along()), torch.full((BATCH,), off, dtype=F64), rtol=0.0, atol=1e-7)
    assert off <= math.atan(max(friction, estimate))


def test_a_velocity_against_the_heading_does_not_count() -> None:
    wall = felt(slid(1.0, 0.25), -0.06 * along(), ANGLE)
    assert_close(wall.tangent, along(), **TIGHT)


# -- symmetries --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [-2.0, 0.3, math.pi])
def test_rotating_the_world_rotates_the_result(angle: float) -> None:
    force, velocity, heading = drawn()
    here, there = felt(force, velocity, heading), felt(turned(force, angle), turned(velocity, angle), heading + angle)
    for one, other in zip(here, there, strict=True):
        assert_close(other, turned(one, angle), **TIGHT)


def test_mirroring_the_world_mirrors_the_result() -> None:
    force, velocity, heading = drawn()
    mirror = torch.tensor((1.0, -1.0, 1.0), dtype=F64)
    here, there = felt(force, velocity, heading), felt(force * mirror, velocity * mirror[:2], -heading)
    for one, other in zip(here, there, strict=True):
        assert_close(other, one * mirror[:2], **TIGHT)


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_tangent_and_normal_have_length_one_and_are_orthogonal(dtype: torch.dtype) -> None:
    force, velocity, heading = (value.to(dtype) for value in drawn())
    wall = felt(force, velocity, heading)
    assert wall.force.dtype == wall.tangent.dtype == wall.normal.dtype == dtype
    one = torch.ones(200, dtype=dtype)
    assert_close(wall.tangent.norm(dim=-1), one, rtol=0.0, atol=1e-5)
    assert_close(wall.normal.norm(dim=-1), one, rtol=0.0, atol=1e-5)
    assert_close((wall.tangent * wall.normal).sum(-1), 0 * one, rtol=0.0, atol=1e-6)


def test_the_wall_is_on_the_side_of_the_heading_that_the_force_is_on() -> None:
    force, _, heading = drawn()
    wall = felt(force, torch.zeros(200, 2, dtype=F64), heading)
    side = turned(force, -heading)[:, 1].sign()
    turn = wall.tangent[:, 0] * wall.normal[:, 1] - wall.tangent[:, 1] * wall.normal[:, 0]
    assert_close(turn, side, **TIGHT)


# -- no wall -----------------------------------------------------------------------------------------------------------


def test_without_force_the_tangent_is_the_direction_of_motion_or_the_heading_of_a_tool_at_rest() -> None:
    none, heading = torch.zeros(BATCH, 3, dtype=F64), ANGLE + 0.5
    ahead = torch.cat([heading.cos(), heading.sin()], -1)
    standing = felt(none, torch.zeros(BATCH, 2, dtype=F64), heading)
    moving = felt(none, 1e4 * SLOW * along(), heading)
    assert_close(standing.tangent, ahead, **TIGHT)
    assert_close(moving.tangent, along(), rtol=0.0, atol=1e-6)
    assert not standing.force.any()


@pytest.mark.parametrize("dtype", [torch.float32, F64])
@pytest.mark.parametrize("force", [0.0, 1e-12, 1e-7, 1e6])
@pytest.mark.parametrize("speed", [0.0, 1e-20, 1e-7, 1e3])
def test_the_result_is_finite_for_forces_and_speeds_of_any_size(dtype: torch.dtype, force: float, speed: float) -> None:
    direction, motion, heading = drawn()
    for value in felt((force * direction).to(dtype), (speed * motion).to(dtype), heading.to(dtype)):
        assert value.isfinite().all()


# -- numbers out of range ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["friction", "slow"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan])
def test_friction_and_speed_that_are_not_positive_are_refused_by_name(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=rf"{name} is {value}; expected a finite number above 0"):
        WallTouch(**{name: value})


@pytest.mark.parametrize(("on", "off"), [(0.4, 0.5), (1.0, 0.0), (1.0, -0.1), (math.nan, 0.5)])
def test_contact_that_begins_below_the_force_where_it_ends_is_refused(on: float, off: float) -> None:
    with pytest.raises(ValueError, match=r"on and off are .* N; expected on >= off > 0"):
        WallTouch(on=on, off=off)
