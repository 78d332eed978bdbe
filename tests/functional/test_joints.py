import math

import pytest
import torch
from torch.testing import assert_close

from ppt_rl.functional.joints import joint_difference, joint_effort
from tests.sampling import normal

F64 = torch.float64


@pytest.mark.parametrize("batch", [(), (5,), (2, 3)], ids=str)
def test_without_a_continuous_joint_the_difference_is_that_of_the_numbers(batch):
    one, other = 5 * normal(*batch, 3), 5 * normal(*batch, 3, seed=1)
    assert torch.equal(joint_difference(one, other, torch.zeros(3, dtype=torch.bool)), one - other)


def test_whole_turns_of_a_continuous_joint_change_nothing_and_those_of_the_others_count():
    one, other, mask = normal(50, 3), normal(50, 3, seed=1), torch.tensor([True, False, True])
    turns = torch.tensor([4 * math.pi, 0.0, -2 * math.pi], dtype=one.dtype)
    assert_close(joint_difference(one + turns, other, mask), joint_difference(one, other, mask), rtol=0, atol=1e-9)
    difference = joint_difference(9 * one, other, mask)
    assert difference[:, [0, 2]].abs().max() <= math.pi
    assert difference[:, 1].abs().max() > math.pi


def test_a_difference_leads_from_one_position_to_the_other():
    one, other, mask = 4 * normal(50, 2), 4 * normal(50, 2, seed=1), torch.tensor([True, True])
    reached = other + joint_difference(one, other, mask)
    assert_close(reached.sin(), one.sin())
    assert_close(reached.cos(), one.cos())


def test_a_damped_joint_under_the_effort_settles_at_its_reference():
    position, velocity, dt = torch.zeros(2, dtype=F64), torch.zeros(2, dtype=F64), 1e-3
    target, k, d = torch.tensor([0.5, -1.0], dtype=F64), torch.tensor([4.0, 9.0], dtype=F64), torch.tensor([4.0, 6.0])
    path = []
    for _ in range(5000):  # of unit inertia, critically damped
        velocity = velocity + dt * joint_effort(target - position, -velocity, k, d)
        position = position + dt * velocity
        path.append(position)
    assert_close(position, target, rtol=0, atol=1e-2)
    assert (torch.stack(path).abs() <= target.abs() + 1e-6).all()  # critically damped: it does not overshoot
