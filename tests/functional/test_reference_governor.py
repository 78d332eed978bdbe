from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from torch.testing import assert_close

from ppt_rl.functional import cartesian_impedance, catch_up, govern_reference, limit_drive, orientation_error
from ppt_rl.functional.rotations import quat_multiply, quat_rotate
from tests.sampling import normal, random_poses, random_quats

F32, F64 = torch.float32, torch.float64
each_dtype = pytest.mark.parametrize("dtype", [F32, F64], ids=["float32", "float64"])
LAWS = settings(max_examples=40, deadline=None, derandomize=True)
STIFFNESS = torch.tensor((400.0, 300.0, 500.0, 30.0, 20.0, 40.0), dtype=F64)
DAMPING = torch.tensor((115.0, 90.0, 118.0, 10.0, 9.5, 3.5), dtype=F64)
LIMITS, SPEEDS, DT = (20.0, 2.0), (0.25, 1.0), 0.01
SEEDS = st.integers(0, 10**6)
#: Sizes of references from far inside the limits to the edge of single precision.
SIZES = st.floats(-6.0, 37.0).map(lambda e: 10.0**e)
BOTH = pytest.mark.parametrize("with_motion", [False, True])


def drive(pose, reference, twist):
    """Wrench on a tool that stands still."""
    gains = STIFFNESS.to(pose.dtype), DAMPING.to(pose.dtype)
    return cartesian_impedance(pose, torch.zeros_like(twist), reference, twist, *gains)


def sizes(wrench):
    return torch.linalg.vector_norm(wrench.unflatten(-1, (2, 3)), dim=-1)


def limit(pose, reference, twist, **kwargs):
    gains = STIFFNESS.to(pose.dtype), DAMPING.to(pose.dtype)
    return limit_drive(pose, reference, twist, *gains, **{"limits": LIMITS, **kwargs})


def govern(reference, pose, last, lag, **kwargs):
    gains = STIFFNESS.to(pose.dtype), DAMPING.to(pose.dtype)
    return govern_reference(
        reference, pose, *gains, last, lag, **{"limits": LIMITS, "speeds": SPEEDS, "dt": DT, **kwargs}
    )


def drawn(seed, size, rows=8, dtype=F64, fast=1.0):
    """A measured pose, a reference at a distance, and a reference's and a measured twist."""
    pose = random_poses(rows, seed=seed).to(dtype)
    reference = random_poses(rows, seed=seed + 1).to(dtype)
    reference[:, :3] = pose[:, :3] + size * normal(rows, 3, seed=seed + 2).to(dtype)
    twist, moving = (fast * normal(rows, 6, seed=seed + i).to(dtype) for i in (3, 4))
    return pose, reference, twist, moving


def slack(pose, reference):
    """Force that half a unit in the last place of the position is worth, twice."""
    ulp = torch.finfo(pose.dtype).eps
    return 400 * ulp * (1 + pose[:, :3].abs().amax(-1) + reference[:, :3].abs().amax(-1)) + 1e4 * ulp


# -- the limit in space ------------------------------------------------------------------------------------------------


@each_dtype
@LAWS
@given(seed=SEEDS, size=SIZES, fast=SIZES)
def test_the_drive_is_within_its_limits_for_every_input(dtype, seed, size, fast):
    pose, reference, twist, _ = drawn(seed, size, dtype=dtype, fast=fast)
    force, torque = sizes(drive(pose, *limit(pose, reference, twist))).unbind(-1)
    assert (force <= LIMITS[0] + slack(pose, pose)).all()
    assert (torque <= LIMITS[1] + 1e4 * torch.finfo(dtype).eps).all()


@each_dtype
@LAWS
@given(seed=SEEDS, size=SIZES, fast=st.floats(-4, 3).map(lambda e: 10.0**e))
def test_with_the_motion_the_wrench_is_a_force_within_the_limits_and_a_brake(dtype, seed, size, fast):
    pose, reference, twist, moving = drawn(seed, size, dtype=dtype, fast=fast)
    gains = STIFFNESS.to(dtype), DAMPING.to(dtype)
    governed = limit(pose, reference, twist, moving=moving)
    wrench = cartesian_impedance(pose, moving, *governed, *gains).double().unflatten(-1, (2, 3))
    drag = (gains[1] * moving).double().unflatten(-1, (2, 3))
    # Distance from the wrench to the segment between zero and the whole drag, which brakes.
    share = (-(wrench * drag).sum(-1, keepdim=True) / drag.square().sum(-1, keepdim=True)).clamp(0, 1)
    rest = torch.linalg.vector_norm(wrench + share * drag, dim=-1)
    rounding = slack(pose, pose) + 8 * torch.finfo(dtype).eps * torch.linalg.vector_norm(drag, dim=-1).amax(-1)
    assert (rest[:, 0] <= LIMITS[0] + rounding).all()
    assert (rest[:, 1] <= LIMITS[1] + rounding).all()


@BOTH
@each_dtype
@LAWS
@given(seed=SEEDS, size=st.floats(1e-6, 0.2))
def test_inside_the_limits_the_reference_is_its_own_bit_by_bit(dtype, with_motion, seed, size):
    pose, reference, twist, moving = drawn(seed, size, dtype=dtype, fast=0.1)
    moving = moving if with_motion else None
    governed, velocity = limit(pose, reference, twist, moving=moving)
    force, torque = sizes(drive(pose, reference, twist)).unbind(-1)
    inside, still = force < LIMITS[0] * 0.9999, torque < LIMITS[1] * 0.9999
    assert torch.equal(governed[inside, :3], reference[inside, :3])
    assert torch.equal(velocity[inside, :3], twist[inside, :3])
    assert torch.equal(governed[still, 3:], reference[still, 3:])
    assert torch.equal(velocity[still, 3:], twist[still, 3:])
    wide, same = limit(pose, reference, twist, moving=moving, limits=(1e6, 1e6))
    assert torch.equal(wide, reference)
    assert torch.equal(same, twist)


def test_a_drive_beyond_its_limit_keeps_its_direction_and_is_at_the_limit():
    pose, reference, twist, _ = drawn(3, 0.5)
    before, after = (
        f.unflatten(-1, (2, 3)) for f in (drive(pose, reference, twist), drive(pose, *limit(pose, reference, twist)))
    )
    assert (sizes(drive(pose, reference, twist)) > torch.tensor(LIMITS)).all()
    expected = before / before.norm(dim=-1, keepdim=True) * torch.tensor(LIMITS, dtype=F64).unsqueeze(-1)
    assert_close(after, expected, rtol=1e-9, atol=1e-9)


def test_a_faster_tool_is_allowed_the_force_of_its_own_damper_and_a_still_one_is_not():
    pose = random_poses(1)
    twist = torch.zeros(1, 6, dtype=F64)
    twist[0, 0] = 0.5  # 57.5 N of feed-forward
    assert_close(limit(pose, pose, twist, moving=twist)[1], twist, rtol=0, atol=0)
    assert limit(pose, pose, twist, moving=torch.zeros_like(twist))[1][0, 0].item() == pytest.approx(20 / 115)
    assert_close(limit(pose, pose, twist), limit(pose, pose, twist, moving=torch.zeros_like(twist)))


def test_a_governed_orientation_lies_on_the_way_from_the_tool_to_the_reference():
    pose, reference, twist, _ = drawn(5, 0.0, rows=64)
    beyond = sizes(drive(pose, reference, 0 * twist))[:, 1] > LIMITS[1]
    governed, _ = limit(pose, reference, 0 * twist)
    error, own = (orientation_error(pose[:, 3:], q[:, 3:]) for q in (reference, governed))
    assert_close(torch.linalg.cross(error, own), torch.zeros_like(own), rtol=0, atol=1e-12)
    assert ((error * own).sum(-1) > 0).all()
    turn = [Rotation.from_quat(np.roll(q[:, 3:].numpy(), -1, 1)) for q in (pose, governed)]
    assert (turn[1] * turn[0].inv()).magnitude()[beyond.numpy()].max() < math.pi / 2  # also where it was beyond
    assert torch.equal(governed[~beyond], reference[~beyond])


# -- the limit in time -------------------------------------------------------------------------------------------------


def angle(one, other):
    pair = [Rotation.from_quat(np.roll(q[..., 3:].numpy(), -1, -1)) for q in (one, other)]
    return torch.from_numpy((pair[0] * pair[1].inv()).magnitude())


@each_dtype
@LAWS
@given(seed=SEEDS, size=st.floats(1e-4, 10.0))
def test_a_pose_that_lags_moves_by_at_most_its_speed_and_towards_the_one_asked_for(dtype, seed, size):
    last, asked, twist, _ = drawn(seed, size, dtype=dtype)
    pose, slow = catch_up(asked, twist, last, torch.ones(8, 2, dtype=dtype), speeds=SPEEDS, dt=DT)
    ulp = torch.finfo(dtype).eps
    moved, gap = (torch.linalg.vector_norm(x[:, :3] - last[:, :3], dim=-1) for x in (pose, asked))
    assert (moved <= SPEEDS[0] * DT + 20 * ulp).all()
    assert_close(moved, gap.clamp_max(SPEEDS[0] * DT), rtol=0, atol=20 * ulp)
    turned, turn = angle(pose.double(), last.double()), angle(asked.double(), last.double())
    assert_close(turned, turn.clamp_max(SPEEDS[1] * DT), rtol=0, atol=20 * ulp)
    assert (sizes(slow) <= sizes(twist) * (1 + 4 * ulp)).all()
    late = (gap > SPEEDS[0] * DT + 20 * ulp) & (turn > SPEEDS[1] * DT + 20 * ulp)
    assert (sizes(slow)[late] <= torch.tensor(SPEEDS, dtype=F64) * (1 + 4 * ulp)).all()


@each_dtype
@LAWS
@given(seed=SEEDS, size=st.floats(1e-4, 10.0))
def test_a_pose_that_does_not_lag_is_the_one_asked_for_bit_by_bit(dtype, seed, size):
    last, asked, twist, _ = drawn(seed, size, dtype=dtype)
    pose, same = catch_up(asked, twist, last, torch.zeros(8, 2, dtype=dtype), speeds=SPEEDS, dt=DT)
    assert torch.equal(pose, asked)
    assert torch.equal(same, twist)


def test_a_blocked_tool_that_comes_free_is_led_on_at_no_more_than_the_speed_until_the_lag_is_over():
    pose = random_poses(1, seed=2)
    last, lag, zero = pose, torch.zeros(1, 2, dtype=F64), torch.zeros(1, 6, dtype=F64)
    asked = torch.cat([pose, zero], -1)
    for _ in range(40):  # blocked: the reference that is asked for runs 40 cm away
        asked[:, 0] += 0.01
        last, _, lag = govern(asked, pose, last, lag)
        assert sizes(drive(pose, last, zero))[0, 0] <= 20.0 + 1e-9
    assert lag[0, 0].item() == pytest.approx(0.4 - 20 / 400)
    steps = []
    for _ in range(300):  # free: the tool is wherever the governed pose is
        before = last
        last, _, lag = govern(asked, last, last, lag)
        steps.append((last - before)[0, :3].norm().item())
    assert max(steps) <= SPEEDS[0] * DT + 1e-12
    assert torch.equal(last, asked[:, :7])
    assert not lag.any()


@BOTH
@LAWS
@given(seed=SEEDS, size=st.floats(1e-3, 1.0))
def test_the_lag_is_the_distance_to_what_was_asked_for_and_zero_only_where_it_is_reached(with_motion, seed, size):
    pose, asked, twist, moving = drawn(seed, size)
    governed = govern(
        torch.cat([asked, twist], -1), pose, pose, torch.zeros(8, 2, dtype=F64), moving=moving if with_motion else None
    )
    assert_close(governed.lag[:, 0], (asked - governed.pose)[:, :3].norm(dim=-1))
    assert_close(governed.lag[:, 1], angle(asked, governed.pose), rtol=0, atol=1e-7)
    same = (governed.pose[:, :3] == asked[:, :3]).all(-1), (governed.pose[:, 3:] == asked[:, 3:]).all(-1)
    assert torch.equal(governed.lag == 0, torch.stack(same, -1))


# -- symmetry, gradients, batches --------------------------------------------------------------------------------------


@BOTH
@LAWS
@given(seed=SEEDS, size=st.floats(1e-3, 1.0))
def test_governing_commutes_with_moving_and_turning_the_world(with_motion, seed, size):
    turn, shift = random_quats(8, seed=seed + 9)[:1].expand(8, 4), normal(3, seed=seed + 8)

    def moved(pose):
        return torch.cat([quat_rotate(turn, pose[:, :3]) + shift, quat_multiply(turn, pose[:, 3:])], -1)

    def turned(twist):
        return torch.cat([quat_rotate(turn, twist[:, :3]), quat_rotate(turn, twist[:, 3:])], -1)

    pose, asked, twist, moving = drawn(seed, size)
    last = drawn(seed + 50, 0.1)[0]
    lag = torch.tensor((1.0, 0.0), dtype=F64).roll(seed % 2).expand(8, 2)
    gains = (torch.tensor((400.0,) * 3 + (30.0,) * 3, dtype=F64), torch.tensor((115.0,) * 3 + (9.0,) * 3, dtype=F64))
    options = {"limits": LIMITS, "speeds": SPEEDS, "dt": DT}
    plain = govern_reference(
        torch.cat([asked, twist], -1), pose, *gains, last, lag, moving=moving if with_motion else None, **options
    )
    world = govern_reference(
        torch.cat([moved(asked), turned(twist)], -1), moved(pose), *gains, moved(last), lag,
        moving=turned(moving) if with_motion else None, **options,
    )  # fmt: skip
    assert_close(world.pose[:, :3], moved(plain.pose)[:, :3], rtol=0, atol=1e-9)
    sign = (world.pose[:, 3:] * moved(plain.pose)[:, 3:]).sum(-1, keepdim=True).sign()
    assert_close(world.pose[:, 3:], sign * moved(plain.pose)[:, 3:], rtol=0, atol=1e-9)
    assert_close(world.twist, turned(plain.twist), rtol=0, atol=1e-9)
    assert_close(world.lag, plain.lag, rtol=0, atol=1e-7)


@BOTH
def test_gradients_agree_with_finite_differences(with_motion):
    pose, asked, twist, moving = drawn(7, 0.3, rows=3)
    last, lag = drawn(8, 0.1, rows=3)[0], torch.ones(3, 2, dtype=F64)

    def law(reference, pose, stiffness, damping):
        options = {"limits": LIMITS, "speeds": SPEEDS, "dt": DT, "moving": moving if with_motion else None}
        governed = govern_reference(reference, pose, stiffness, damping, last, 0 * lag, **options)
        late = govern_reference(reference, pose, stiffness, damping, last, lag, **options)
        return *governed, *late

    inputs = [x.clone().requires_grad_() for x in (torch.cat([asked, twist], -1), pose, STIFFNESS, DAMPING)]
    assert torch.autograd.gradcheck(law, inputs)


def test_gradients_are_finite_where_reference_tool_and_last_pose_are_one():
    pose = random_poses(2).requires_grad_()
    twist = torch.zeros(2, 6, dtype=F64, requires_grad=True)
    governed = govern(torch.cat([pose, twist], -1), pose, pose, torch.zeros(2, 2, dtype=F64), moving=twist)
    (governed.pose.sum() + governed.twist.sum()).backward()
    assert pose.grad.isfinite().all()
    assert twist.grad.isfinite().all()
