"""What a policy sees of the motion that a tool remembers."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close
from torchrl.envs import TransformedEnv

from ppt_rl.functional.heading import from_heading
from ppt_rl.functional.motion import follow_course, follow_creep
from ppt_rl.transforms import MotionMemoryTransform
from tests.sampling import normal
from tests.transforms.mocks import ScriptedEnv, play

F64 = torch.float64
ROWS, STEPS = 3, 12


def scripted(twist: Tensor, heading: Tensor, **kwargs: Any) -> TransformedEnv:
    """An environment that tells twists ``(B, T + 1, 6)`` and headings ``(B, T + 1, 1)``."""
    return TransformedEnv(ScriptedEnv(1, twist=twist, heading=heading), MotionMemoryTransform(**{"dt": 0.01, **kwargs}))


def drawn(scale: float = 0.02) -> tuple[Tensor, Tensor]:
    return scale * normal(ROWS, STEPS + 1, 6), normal(ROWS, STEPS + 1, 1, seed=1)


def watch(env: TransformedEnv, steps: int = STEPS) -> Any:
    return play(env, torch.zeros(steps, *env.batch_size, 1, dtype=F64))


def test_an_episode_begins_without_creep_on_the_course_of_its_heading():
    twist, heading = drawn()
    root = scripted(twist, heading).reset()
    assert not root["creep"].any()
    assert not root["heading_creep"].any()
    assert_close(root["course"], torch.cat([heading[:, 0].cos(), heading[:, 0].sin()], -1))
    assert_close(root["heading_course"], torch.tensor([1.0, 0.0], dtype=F64).expand(ROWS, 2))


def test_state_follows_the_laws_and_is_seen_in_heading_axes():
    twist, heading = drawn()
    steps = watch(scripted(twist, heading))["next"]
    creep, course = torch.zeros(ROWS, 2, dtype=F64), torch.cat([heading[:, 0].cos(), heading[:, 0].sin()], -1)
    for t in range(STEPS):
        creep = follow_creep(creep, twist[:, t + 1, :2], dt=0.01)
        course = follow_course(course, twist[:, t + 1, :2], dt=0.01)
        assert_close(steps["creep"][:, t], creep)
        assert_close(steps["course"][:, t], course)
        for key, vector in (
            ("heading_creep", creep / (creep.norm(dim=-1, keepdim=True) + 1e-3)),
            ("heading_course", course),
        ):
            seen = torch.cat([steps[key][:, t], torch.zeros(ROWS, 1, dtype=F64)], -1)
            assert_close(from_heading(seen, heading[:, t + 1])[:, :2], vector)
    assert steps["creep"].any()


def test_the_mirror_image_of_a_motion_is_seen_mirrored():
    twist, heading = drawn()
    mirrored = twist * torch.tensor([1.0, -1.0, 1.0, -1.0, 1.0, -1.0], dtype=F64)
    one, other = (watch(scripted(*inputs))["next"] for inputs in ((twist, heading), (mirrored, -heading)))
    for key in ("heading_creep", "heading_course"):
        assert_close(one[key] * torch.tensor([1.0, -1.0], dtype=F64), other[key])


def test_a_partial_reset_and_a_step_mask_leave_the_other_rows_alone():
    twist, heading = drawn()
    env = scripted(twist, heading)
    root = env._step_mdp(watch(env, 4)[:, -1]).set("action", torch.zeros(ROWS, 1, dtype=F64))
    masked = env.step(root.clone().set("_step", torch.tensor([True, False, True])))["next"]
    again = env.reset(root.clone().set("_reset", torch.tensor([[False], [True], [False]])))
    for key in ("creep", "course"):
        assert torch.equal(masked[key][1], root[key][1])
        assert not torch.equal(masked[key][0], root[key][0])
        assert torch.equal(again[key][[0, 2]], root[key][[0, 2]])
    assert not again["creep"][1].any()


@pytest.mark.parametrize("name", ["slow", "memory", "distance", "reach", "dt"])
def test_a_number_that_is_not_positive_is_refused_by_name(name):
    with pytest.raises(ValueError, match=rf"{name} is nan; expected a finite number above 0"):
        MotionMemoryTransform(**{name: math.nan})
