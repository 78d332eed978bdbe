"""The policy that is told what is hidden: it is told the truth, and of each episode its own."""

from __future__ import annotations

import pytest
import torch
from torchrl.envs.utils import ExplorationType, check_env_specs, set_exploration_type

from benchmarks import informed_push
from ppt_rl.envs.push import PushRandomisation


def make_env(num_envs: int = 3, *, mirror: bool = True):
    drawn = PushRandomisation(com=(-0.015, 0.015), error=(-0.01, 0.01))
    config = informed_push.Config(randomisation=drawn, replan_steps=25, num_threads=1, mirror=mirror)
    modules = informed_push.RECIPE.make_modules(config)
    informed_push.RECIPE.fit(config, **modules)
    return informed_push.RECIPE.make_env(config, modules, num_envs=num_envs, seed=0), config


def test_it_sees_the_drawn_centre_of_mass_mass_friction_and_error_of_every_row():
    env, _ = make_env()
    check_env_specs(env)
    td = env.reset()
    physical = env.base_env._episode.physical
    expected = torch.cat([physical["com"], physical["mass"], physical["friction"]], -1).float()
    torch.testing.assert_close(td["hidden"][:, :4], expected)
    error = td["box_start"] - td["box_pose"][:, :2]
    torch.testing.assert_close(td["hidden"][:, 4:], error, atol=1e-6, rtol=0.0)
    assert (error.abs() > 1e-4).any()
    later = env.step(td.set("action", env.action_spec.zero()))["next"]
    torch.testing.assert_close(later["hidden"], td["hidden"])


def test_a_row_that_begins_anew_is_told_of_its_new_episode_and_the_others_stay():
    env, _ = make_env()
    td = env.reset()
    before = td["hidden"].clone()
    td["_reset"] = torch.tensor([[False], [True], [False]])
    after = env.reset(td)["hidden"]
    assert torch.equal(after[[0, 2]], before[[0, 2]])
    assert not torch.isclose(after[1], before[1]).any()


@pytest.mark.parametrize("mirror", [True, False])
def test_what_its_policy_does_depends_on_what_is_hidden(mirror):
    env, config = make_env(mirror=mirror)
    actor, critic = informed_push.make_policy(config, env)
    td = env.reset()
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        told = [actor(critic(td.clone().set("hidden", td["hidden"] + more))) for more in (0.0, 0.5)]
    assert told[0]["action"].shape == env.action_spec.shape
    assert not torch.equal(told[0]["loc"], told[1]["loc"])
    assert not torch.equal(told[0]["state_value"], told[1]["state_value"])
