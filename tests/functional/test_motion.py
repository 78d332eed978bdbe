"""What a sliding tool remembers: creep while it is held up, and the course over which it has travelled."""

from __future__ import annotations

import pytest
import torch
from torch.testing import assert_close

from ppt_rl.functional.motion import follow_course, follow_creep
from tests.sampling import normal

F64 = torch.float64


def crept(velocity, steps, creep=(0.0, 0.0), **law):
    value, speed = torch.tensor([creep], dtype=F64), torch.tensor([velocity], dtype=F64)
    for _ in range(steps):
        value = follow_creep(value, speed, dt=0.01, **law)
    return value[0]


def test_a_tool_that_is_held_up_adds_up_its_creep_and_forgets_it():
    assert_close(crept((0.0, 0.005), 10, memory=1e9), torch.tensor([0.0, 0.0005], dtype=F64), rtol=1e-6, atol=0.0)
    assert_close(crept((0.0, 0.005), 2000), torch.tensor([0.0, 0.005 * 0.4], dtype=F64), rtol=1e-6, atol=0.0)
    assert_close(crept((0.0, 0.0), 40, creep=(0.001, 0.0))[0], torch.tensor(0.001 * 0.975**40, dtype=F64))


def test_a_tool_that_comes_free_has_not_crept_and_one_in_between_keeps_its_creep():
    assert crept((0.07, 0.0), 1, creep=(0.001, 0.002)).tolist() == [0.0, 0.0]
    assert crept((0.04, 0.0), 5, creep=(0.001, 0.002)).tolist() == [0.001, 0.002]
    assert crept((0.04, 0.0), 1, creep=(0.001, 0.002), slow=0.05)[0] > 0.001


def test_the_course_follows_the_distance_travelled_and_not_the_time():
    course, east = torch.tensor([[0.0, 1.0]], dtype=F64), torch.tensor([[1.0, 0.0]], dtype=F64)
    slow = fast = course
    for _ in range(4000):
        slow = follow_course(slow, 0.002 * east, dt=0.01)
    for _ in range(400):
        fast = follow_course(fast, 0.02 * east, dt=0.01)
    assert_close(slow, fast, rtol=0.0, atol=2e-3)
    share = torch.tensor(-0.08 / 0.08).exp()  # 8 cm travelled
    assert_close(fast, torch.tensor([[1 - share, share]], dtype=F64), rtol=0.0, atol=2e-3)
    assert torch.equal(follow_course(course, 0.0 * east, dt=0.01), course)


def test_the_course_is_no_longer_than_one():
    course = torch.tensor([[1.0, 0.0]], dtype=F64).expand(50, 2)
    for seed in range(200):
        course = follow_course(course, 0.2 * normal(50, 2, seed=seed), dt=0.01)
        assert (course.norm(dim=-1) <= 1 + 1e-12).all()


@pytest.mark.parametrize("law", [follow_creep, follow_course])
def test_a_turn_of_the_world_turns_what_is_remembered(law):
    state, velocity = 0.001 * normal(20, 2), 0.02 * normal(20, 2, seed=1)
    turn = torch.tensor([[0.6, -0.8], [0.8, 0.6]], dtype=F64)
    assert_close(law(state @ turn.T, velocity @ turn.T, dt=0.01), law(state, velocity, dt=0.01) @ turn.T)


@pytest.mark.parametrize("law", [follow_creep, follow_course])
def test_other_than_two_numbers_are_refused(law):
    with pytest.raises(ValueError, match=r"velocity has shape \(3, 6\); expected \(\*batch, 2\)"):
        law(torch.zeros(3, 2), torch.zeros(3, 6), dt=0.01)
    with pytest.raises(ValueError, match=r"(creep|course) has shape \(3, 3\); expected \(\*batch, 2\)"):
        law(torch.zeros(3, 3), torch.zeros(3, 2), dt=0.01)
