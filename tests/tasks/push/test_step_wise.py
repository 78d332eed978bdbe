"""Step-wise policies with and without the reference that the episode-level ones have."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from ppt_rl.evaluation import find_recipe, load_policy, run_episodes
from ppt_rl.evaluation.episodes import ZeroPolicy
from ppt_rl.training import PPOConfig, with_settings

RECIPE = find_recipe("s_push")


def config(**settings: str):
    return with_settings(RECIPE.config(num_threads=1, physics_dt=0.002), settings)


def success_of_zeros(**settings: str) -> float:
    options = config(box_sizes="0.06", **settings)
    modules = RECIPE.make_modules(options)
    RECIPE.fit(options, **modules)
    env = RECIPE.make_env(options, modules, num_envs=24, seed=7)
    actor, _ = RECIPE.make_policy(options, env)
    rows = run_episodes(env, ZeroPolicy(actor), 24)
    env.close()
    return float(rows["success"].mean())


def test_on_the_reference_an_action_of_zero_pushes_the_box_as_the_reference_does():
    assert success_of_zeros(goal="position", on_reference="true") > 0.7
    assert success_of_zeros(goal="position") == 0.0


@pytest.mark.parametrize(("goal", "speed"), [("pose", 0.4), ("position", 0.2)])
def test_the_largest_velocity_is_that_of_the_goal_and_twice_that_on_the_reference(goal: str, speed: float):
    options = config(goal=goal, num_envs="2")
    assert options.velocity[:2] == (speed, speed)
    for on_reference, factor in (("false", 1.0), ("true", 2.0)):
        changed = config(goal=goal, on_reference=on_reference)
        modules = RECIPE.make_modules(changed)
        env = RECIPE.make_env(changed, modules, num_envs=1, seed=0)
        limit = next(part for part in env.transform if hasattr(part, "max_lead")).max_velocity
        torch.testing.assert_close(limit[:2], torch.full((2,), factor * speed))
        env.close()


def test_a_policy_on_the_reference_is_saved_with_it(tmp_path: Path):
    ppo = PPOConfig(total_control_steps=40, epochs=1, minibatches=1)
    options = RECIPE.config(
        run_dir=tmp_path, num_envs=2, num_threads=1, duration=0.2, physics_dt=0.002, on_reference=True, ppo=ppo
    )
    RECIPE.train(options)
    policy = load_policy(tmp_path)
    assert policy.modules["promp"].weights_mean.abs().sum() > 0
    assert policy.make_env(2, seed=0).rollout(1, policy.actor)["next", "phase"].shape == (2, 1, 1)
