from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from torchrl.envs.utils import check_env_specs

from ppt_rl.evaluation import Recipe, evaluate, find_recipe, load_policy
from ppt_rl.training import with_settings

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "examples" / "wipe"
TINY = {
    "num_envs": "2", "num_threads": "1", "physics_dt": "0.002", "duration": "0.6", "num_basis": "4",
    "replan_steps": "30", "ppo.total_control_steps": "120", "ppo.epochs": "1", "ppo.minibatches": "1",
}  # fmt: skip


@pytest.fixture(scope="module")
def recipe() -> Recipe:
    return find_recipe(FOLDER / "ppo_ppt_wipe.py")


@pytest.fixture
def env(recipe: Recipe) -> Iterator:
    base = recipe.task.make_test_env(with_settings(recipe.config(), TINY), num_envs=3, seed=0, audit=False)
    yield base
    base.close()


def test_the_third_task_is_one_folder_of_at_most_300_lines():
    assert sum(len(path.read_text().splitlines()) for path in FOLDER.glob("*.py")) <= 300
    assert {path.suffix for path in FOLDER.iterdir() if path.is_file()} == {".py"}


def test_the_environment_keeps_its_specs_and_masks(env):
    check_env_specs(env)


def test_nothing_is_wiped_before_the_board_is_touched(env):
    rollout = env.rollout(3)
    assert (rollout["next", "progress"] == 0).all()
    assert not rollout["next", "success"].any()
    assert rollout["next", "reward_terms", "progress"].abs().max() == 0


def test_the_reference_presses_by_its_depth_under_the_believed_board(env):
    episode = env.reset()
    via = episode["via_position"]
    torch.testing.assert_close(via[:, 1, 2], via[:, 2, 2])
    deeper = via[0, 1, 2] - via[1, 1, 2]
    softer = episode["wanted_force"][1, 0] - episode["wanted_force"][0, 0]
    torch.testing.assert_close(deeper, softer / 400.0)


def test_the_policy_reads_nothing_of_the_board(recipe):
    config = with_settings(recipe.config(), TINY)
    env = recipe.make_env(config, recipe.make_modules(config), num_envs=2, seed=0)
    actor, critic = recipe.make_policy(config, env)
    assert "board" not in actor.in_keys
    assert "board" in critic.in_keys
    env.close()


def test_it_trains_and_is_judged_beside_its_baselines_like_any_other_task(recipe, tmp_path):
    path = recipe.train(with_settings(recipe.config(run_dir=tmp_path), TINY))
    policy = load_policy(path)
    result = evaluate(policy, episodes=2, seed=1, baselines=True)
    assert list(result.rows) == ["ppt_wipe", "reference alone", *recipe.task.baselines]
    assert "board" not in policy.make_env(2).observation_spec.keys()
