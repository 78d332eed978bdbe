"""What the hooks of a task return wrongly is refused by the name of the hook."""

from __future__ import annotations

import pytest
import torch

from ppt_rl.envs import PushEnv
from tests.engines import ONE_THREAD


def make(**hooks) -> PushEnv:
    """A pushing environment of two rows, some of whose hooks are others."""
    return type("Mine", (PushEnv,), hooks)(2, duration=0.1, seed=0, engine=ONE_THREAD)


def step(env: PushEnv):
    return env.step(env.reset().set("action", torch.zeros(2, 7)))


def test_the_right_ones_pass_and_a_task_may_be_over_early():
    env = make(_task_over=lambda self: (self._elapsed > 0) & torch.tensor([[True], [False]]))
    assert step(env)["next", "terminated"].flatten().tolist() == [True, False]


@pytest.mark.parametrize("over", [torch.zeros(2, dtype=torch.bool), torch.zeros(2, 1)], ids=["flat", "numbers"])
def test_a_flag_of_the_end_has_a_column_and_is_a_flag(over):
    with pytest.raises(ValueError, match=r"Mine\._task_over returned .*; expected torch.bool of shape \(2, 1\)"):
        step(make(_task_over=lambda self: over))


def test_positions_of_too_few_joints_are_refused():
    env = make(_begin=lambda self, rows: PushEnv._begin(self, rows)[:, :-1])
    with pytest.raises(ValueError, match=r"Mine\._begin returned positions of shape \(2, 13\); expected \(2, 14\)"):
        env.reset()


@pytest.mark.parametrize("hook", ["_task_reset", "_task_step"])
def test_observations_of_another_shape_are_refused(hook):
    def flat(self, *args):
        returned = getattr(PushEnv, hook)(self, *args)
        return returned | {"success": returned["success"].squeeze(-1)}

    with pytest.raises(ValueError, match=rf"Mine\.{hook} returned 'success' of shape \(2,\); expected \(2, 1\)"):
        step(make(**{hook: flat}))


@pytest.mark.parametrize("hook", ["_task_reset", "_task_step"])
def test_rewards_and_observations_that_are_not_declared_are_refused(hook):
    def more(self, *args):
        returned = getattr(PushEnv, hook)(self, *args)
        return returned | {"reward_terms": returned["reward_terms"] | {"luck": torch.zeros(2, 1)}}

    with pytest.raises(ValueError, match=rf"Mine\.{hook} returned 'luck'; expected what _task_spec declares, among"):
        step(make(**{hook: more}))
