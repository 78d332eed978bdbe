from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from ppt_rl.evaluation import evaluate, find_recipe, find_recipes, load_policy, shipped_recipes
from ppt_rl.training import CheckpointMismatch, PPOConfig, checkpoint_info, with_settings

#: A recipe of a user's own: a neighbour holds a constant, and the variant is PPT under another name.
NEIGHBOUR = "SCALE = 0.125\n"
RECIPE = """
from dataclasses import replace

from my_constants import SCALE
from ppt_rl.recipes.ppo_ppt_push import RECIPE as PPT, Config


def make_chain(config, base, promp):
    return PPT.make_chain(config, base, promp)


RECIPE = replace(PPT, variant="mine_push", label="mine", make_chain=make_chain)

if __name__ == "__main__":
    RECIPE.main()
"""
TINY = {
    "num_envs": "4", "num_threads": "1", "duration": "0.2", "physics_dt": "0.002", "num_basis": "4",
    "ppo.total_control_steps": "80",
}  # fmt: skip


@pytest.fixture(scope="module")
def mine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """File of a recipe of a user's own."""
    folder = tmp_path_factory.mktemp("mine")
    (folder / "my_constants.py").write_text(NEIGHBOUR)
    (folder / "ppo_mine_push.py").write_text(RECIPE)
    return folder / "ppo_mine_push.py"


@pytest.fixture(scope="module")
def trained(mine: Path) -> Path:
    """Checkpoint of a tiny training with it."""
    recipe = find_recipe(mine)
    config = with_settings(recipe.config(run_dir=mine.parent / "run", ppo=PPOConfig(epochs=1, minibatches=1)), TINY)
    return recipe.train(config)


def test_every_shipped_recipe_is_found_by_its_variant_and_by_its_file():
    for variant, file in shipped_recipes().items():
        recipe = find_recipe(variant)
        assert recipe.variant == variant
        assert recipe.file == file
        assert find_recipe(file) is recipe
        assert recipe.identity == {"variant": variant}


def test_a_recipe_of_a_users_own_is_found_by_its_file_only(mine):
    recipe = find_recipe(mine)
    assert recipe.variant == "mine_push"
    assert recipe.identity == {"variant": "mine_push", "recipe": str(mine.resolve())}
    assert find_recipe(mine) is recipe
    with pytest.raises(CheckpointMismatch, match=r"'mine_push' is unknown; expected one of .*or the file"):
        find_recipe("mine_push")


def test_a_file_without_a_recipe_is_refused(tmp_path):
    (tmp_path / "empty.py").write_text("VARIANT = 3\n")
    with pytest.raises(CheckpointMismatch, match=r"empty\.py defines no recipe; expected RECIPE = Recipe"):
        find_recipe(tmp_path / "empty.py")


def test_a_policy_of_a_users_own_recipe_is_loaded_and_judged_like_any_other(mine, trained):
    assert checkpoint_info(trained)["recipe"] == str(mine.resolve())
    policy = load_policy(trained)
    assert policy.recipe is find_recipe(mine)
    rows = evaluate(policy, episodes=2, seed=1, baselines=True).rows
    assert list(rows) == ["mine_push", "reference alone", "naive reference"]


def test_a_recipe_that_moved_is_named_and_can_be_given(mine, trained, tmp_path):
    moved = Path(shutil.copytree(mine.parent, tmp_path / "moved"))
    run = next((moved / "run" / "checkpoints").glob("*.torchrl"))
    policy = load_policy(run, recipe=moved / "ppo_mine_push.py")
    assert policy.recipe.file == (moved / "ppo_mine_push.py").resolve()
    with pytest.raises(CheckpointMismatch, match="'mine_push'; expected a recipe of it, and 'pp_push' makes 'pp_push'"):
        load_policy(run, recipe="pp_push")


def test_a_users_recipe_runs_as_a_script_and_through_the_command_line(mine, tmp_path):
    options = [
        "--num-envs", "4", "--duration", "0.2", "--physics-dt", "0.002", "--num-basis", "4",
        "--ppo.total-control-steps", "80",
    ]  # fmt: skip
    for name, command in (("script", [str(mine)]), ("cli", ["-m", "ppt_rl", "train", str(mine)])):
        run = subprocess.run(
            [sys.executable, *command, "--run-dir", str(tmp_path / name), *options], capture_output=True, text=True
        )
        assert run.returncode == 0, run.stderr
        assert json.loads((tmp_path / name / "config.json").read_text())["config"]["variant"] == "mine_push"
        assert load_policy(tmp_path / name).variant == "mine_push"


def test_recipes_are_found_by_task_variant_and_file_together(mine):
    assert [recipe.variant for recipe in find_recipes(["maze", mine])] == ["ppt_maze", "st_maze", "mine_push"]
