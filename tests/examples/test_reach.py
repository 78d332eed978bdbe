"""The smallest task: its specs, its rows, what the reference does behind the tank, and a training."""

from __future__ import annotations

import dataclasses
import warnings
from pathlib import Path

import pytest
import torch
from torchrl.envs.utils import check_env_specs

from ppt_rl.evaluation import evaluate, find_recipe, load_policy, record_episodes
from ppt_rl.tasks import motor_tank
from ppt_rl.training import with_settings

FILE = Path(__file__).resolve().parents[2] / "examples" / "reach" / "ppo_ppt_reach.py"


@pytest.fixture(scope="module")
def recipe():
    return find_recipe(FILE)


@pytest.fixture(scope="module")
def env(recipe):
    base = recipe.task.make_test_env(recipe.config(num_threads=1), num_envs=3, seed=0)
    yield base
    base.close()


def test_it_is_one_file():
    assert [path.name for path in FILE.parent.iterdir() if path.is_file()] == [FILE.name]


def test_the_environment_keeps_its_specs(env):
    check_env_specs(env)


def test_the_episodes_of_a_row_do_not_depend_on_the_batch(recipe, env):
    env.set_seed(5)
    alone = recipe.task.make_test_env(recipe.config(num_threads=1), num_envs=1, seed=None)
    alone.first_row = 2
    alone.set_seed(5)
    torch.testing.assert_close(alone.reset()["goal"][0], env.reset()["goal"][2], rtol=0, atol=0)
    alone.close()


def test_progress_is_zero_at_the_start_and_the_goal_is_the_last_via_point(env):
    episode = env.reset()
    assert (episode["progress"] == 0).all()
    torch.testing.assert_close(episode["via_position"][:, -1], episode["goal"])


def test_the_tank_is_what_keeps_the_reference_from_the_farther_goals(recipe):
    shares = {}
    for room in (1.0, 100.0):
        config = recipe.config(num_threads=1, p_max=2.0 * room, e_max=1.0 * room)
        modules = recipe.make_modules(config)
        recipe.fit(config, **modules)
        env = recipe.make_env(config, modules, num_envs=32, seed=1)
        end = env.rollout(1, lambda td: td.set("action", torch.zeros(32, 12)))["next"][:, 0]
        shares[room] = float(end["success"].float().mean())
    assert shares[100.0] > 0.75 > shares[1.0]


def test_it_trains_and_is_judged_through_the_same_commands(recipe, tmp_path):
    settings = {
        "num_envs": "2", "num_threads": "1", "duration": "0.3", "physics_dt": "0.002", "validate_every": "0",
        "ppo.total_control_steps": "120", "ppo.epochs": "1", "ppo.minibatches": "1", "run_dir": str(tmp_path / "run"),
    }  # fmt: skip
    recipe.train(with_settings(recipe.config(), settings))
    policy = load_policy(tmp_path / "run")
    judged = evaluate(policy, episodes=2, num_envs=2, seed=1, baselines=True).as_json()
    assert set(judged["baselines"]) == {"reference alone"}
    assert set(judged["success"]) == {"mean", "ci95"}
    recorded = record_episodes(policy.make_env(2, seed=1), policy.actor, policy.recipe.traced)  # what a film shows
    assert recorded["trace", "tank_energy"].shape == (2, 30, 1)


def test_a_recipe_with_a_tank_that_films_cannot_find_is_refused_before_it_is_trained(recipe, tmp_path):
    def make_chain(config, base, promp):
        chain = recipe.make_chain(config, base, promp)
        return [motor_tank(config.p_max, config.e_max), *chain[1:]]

    other = dataclasses.replace(recipe, make_chain=make_chain)
    with pytest.raises(ValueError, match=r"has_tank=True, but its chain writes no \['tank_energy', 'valve'\]"):
        other.train(recipe.config(num_envs=2, num_threads=1, run_dir=tmp_path / "run"))


def test_a_warning_says_where_the_end_of_an_only_decision_is_not_the_end_for_the_critic(recipe, env, monkeypatch):
    config = recipe.config(num_threads=1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        recipe._advise(config, env)
    monkeypatch.setattr(type(env), "horizon_terminates", False)
    with pytest.warns(UserWarning, match=r"ReachEnv has horizon_terminates=False.*Set horizon_terminates = True"):
        recipe._advise(config, env)
