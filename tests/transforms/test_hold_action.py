"""Decisions that are held or approached over several control steps."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close
from torchrl.envs import Compose, TransformedEnv

from ppt_rl.transforms import HoldActionTransform, MacroStepTransform
from tests.transforms.mocks import MockArmEnv

F64 = torch.float64


def chunk_of(action: torch.Tensor, **kwargs: float) -> torch.Tensor:
    return HoldActionTransform(4, **kwargs).inv(TensorDict(action=action, batch_size=action.shape[:-1]))["action"]


def test_without_smoothing_the_action_is_repeated():
    action = torch.randn(3, 2)
    assert_close(chunk_of(action), action.unsqueeze(1).expand(3, 4, 2), atol=0, rtol=0)


@pytest.mark.parametrize("smoothing", [0.2, 0.8])
def test_the_closed_form_is_the_low_pass_step_by_step(smoothing):
    action, value = torch.randn(3, 2, dtype=F64), torch.zeros(3, 2, dtype=F64)
    for step in chunk_of(action, smoothing=smoothing).unbind(1):
        value = smoothing * value + (1 - smoothing) * action
        assert_close(step, value)


def held(num_envs: int = 2, smoothing: float = 0.5) -> TransformedEnv:
    return TransformedEnv(
        MockArmEnv((num_envs,), horizons=(100,)),
        Compose(MacroStepTransform(4), HoldActionTransform(4, smoothing=smoothing)),
    )


def test_the_next_chunk_goes_on_from_the_last_action_executed():
    env = held()
    first = env.step(env.reset().set("action", torch.ones(2, 7)))
    assert_close(first["next", "last_action"], torch.full((2, 7), 1 - 0.5**4))
    second = env.step(env.step_mdp(first).set("action", torch.zeros(2, 7)))
    assert_close(second["next", "last_action"], torch.full((2, 7), (1 - 0.5**4) * 0.5**4))


def test_a_reset_forgets_the_last_action_of_the_environments_that_reset_only():
    env = held()
    root = env.step_mdp(env.step(env.reset().set("action", torch.ones(2, 7))))
    root["_reset"] = torch.tensor([[True], [False]])
    assert_close(env.reset(root)["last_action"][:, 0], torch.tensor([0.0, 1 - 0.5**4]))


@pytest.mark.parametrize("count", [1, 3])
def test_of_a_chunk_that_was_cut_short_the_last_action_executed_counts(count):
    chunk = torch.arange(4.0).reshape(1, 4, 1)
    assert HoldActionTransform._executed(chunk, torch.tensor([[count]])).item() == count - 1


def test_it_is_refused_where_no_macro_step_of_its_length_executes_the_chunk():
    for chain in ([HoldActionTransform(4)], [MacroStepTransform(5), HoldActionTransform(4)]):
        with pytest.raises(ValueError, match=r"expected a chunk .*MacroStepTransform\(4\)"):
            TransformedEnv(MockArmEnv((2,)), Compose(*chain)).reset()


@pytest.mark.parametrize("smoothing", [-0.1, 1.0, float("nan"), "much", True])
def test_an_impossible_smoothing_is_refused(smoothing):
    with pytest.raises(ValueError, match="smoothing is"):
        HoldActionTransform(3, smoothing=smoothing)


def test_an_action_that_is_not_finite_is_refused():
    with pytest.raises(ValueError, match="action \\(held\\)"):
        chunk_of(torch.full((1, 2), torch.nan))
