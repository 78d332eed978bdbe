"""The law of via-points from touch without a transform; tests/transforms/test_contact_via_point.py tests it in time."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from ppt_rl.functional.contact import WallContact
from ppt_rl.functional.contact_via_point import (
    ContactViaPoints,
    ViaPointConfig,
    begin_via_points,
    update_via_points,
)
from tests.sampling import normal, random_poses

F64 = torch.float64
CONFIG = ViaPointConfig(capacity=3, lookahead=0.3, spacing=0.05)
DURATION, DT = 0.8, 0.01


def wall(way: Tensor) -> WallContact:
    """A wall on the left of a tool that goes along angles ``(*B, 1)``."""
    tangent, normal_ = torch.cat([way.cos(), way.sin()], -1), torch.cat([-way.sin(), way.cos()], -1)
    return WallContact(4.0 * normal_, normal_, tangent)


def after(steps: int, poses: Tensor, way: Tensor, touch: Tensor) -> ContactViaPoints:
    points = begin_via_points(poses, CONFIG)
    for _ in range(steps):
        points = update_via_points(points, poses, wall(way), touch, CONFIG, duration=DURATION, dt=DT)
    return points


def test_an_empty_buffer_has_the_shapes_and_the_precision_of_the_pose() -> None:
    points = begin_via_points(torch.zeros(2, 5, 7, dtype=F64), CONFIG)
    shapes = {key: tuple(value.shape[2:]) for key, value in points._asdict().items()}
    assert all(value.shape[:2] == (2, 5) for value in points)
    assert shapes == {
        "contact": (1,), "new_wall": (1,), "via_mask": (3,), "via_wait": (1,), "via_pause": (1,), "via_phase": (3,),
        "via_tangent": (2,), "via_position": (3, 3), "via_cov": (3, 3, 3),
    }  # fmt: skip
    assert {value.dtype for value in points} == {torch.bool, F64}
    assert not points.via_mask.any()


def test_an_update_leaves_the_old_buffer_alone() -> None:
    poses, touch = random_poses(4), torch.ones(4, 1, dtype=torch.bool)
    old = after(3, poses, normal(4, 1), touch)
    kept = [value.clone() for value in old]
    update_via_points(old, poses, wall(normal(4, 1) + 2.0), touch, CONFIG, duration=DURATION, dt=DT)
    assert all(torch.equal(one, other) for one, other in zip(old, kept, strict=True))


def test_every_row_of_a_batch_is_treated_as_if_it_were_alone() -> None:
    poses, way = random_poses(6), normal(6, 1)
    touch = torch.tensor([True, False] * 3).unsqueeze(-1)
    together = after(12, poses, way, touch)
    for row in range(6):
        alone = after(12, poses[row], way[row], touch[row])
        assert all(torch.equal(one[row], other) for one, other in zip(together, alone, strict=True))
    assert torch.equal(together.via_mask.any(-1, keepdim=True), touch)


@pytest.mark.parametrize("scale", [0.5, 3.0])
def test_standard_deviations_scale_the_covariance_by_their_square(scale: float) -> None:
    poses, touch = random_poses(4), torch.ones(4, 1, dtype=torch.bool)
    wide = ViaPointConfig(capacity=1, std=tuple(scale * value for value in CONFIG.std))
    narrow = ViaPointConfig(capacity=1)
    covs = [
        update_via_points(begin_via_points(poses, c), poses, wall(normal(4, 1)), touch, c, duration=1.0, dt=DT).via_cov
        for c in (wide, narrow)
    ]
    torch.testing.assert_close(covs[0], scale**2 * covs[1])
