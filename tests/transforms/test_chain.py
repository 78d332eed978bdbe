from __future__ import annotations

import torch
from torchrl.envs import Compose, TransformedEnv

from ppt_rl.transforms.chain import step_inside
from tests.transforms.cases import control_chain
from tests.transforms.mocks import MockArmEnv


def make_env() -> TransformedEnv:
    env = TransformedEnv(MockArmEnv((3,), horizons=(9,)), Compose(*control_chain()))
    env.set_seed(0)
    return env


def test_a_step_inside_is_that_of_the_environment_and_leaves_the_root_alone() -> None:
    one, other = make_env(), make_env()
    root = one.reset()
    other.reset()
    root["action"] = torch.cat([root["pose"] + 0.01, torch.zeros(3, 6)], -1)
    for mask in (None, torch.tensor([True, False, True])):
        given = root.copy() if mask is None else root.copy().set("_step", mask)
        kept, expected = given.copy(), one._step(given.copy())
        found = step_inside(other, given)
        assert set(given.keys(True, True)) == set(kept.keys(True, True))
        assert all(given[key] is kept[key] for key in kept.keys(True, True))
        assert set(found.keys(True, True)) == set(expected.keys(True, True))
        for key, value in expected.items(True, True):
            torch.testing.assert_close(found[key], value, rtol=0.0, atol=0.0)


def test_an_environment_that_is_not_transformed_steps_by_itself() -> None:
    env = MockArmEnv((3,))
    root = env.reset()
    root["action"] = torch.ones(3, 7)
    torch.testing.assert_close(step_inside(env, root)["push"], env._step(root)["push"])
