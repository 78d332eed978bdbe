from __future__ import annotations

import json
import shutil

import pytest

from ppt_rl.recipes.ppo_st_push import RECIPE as OTHER
from ppt_rl.training import CheckpointMismatch, checkpoint_info, find_checkpoint, options_to_resume
from ppt_rl.training.checkpoint import all_checkpoints
from ppt_rl.training.logs import read_scalar
from tests.training.tiny import BATCH, OPTIONS, RECIPE, tiny, train


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A run of three batches with seed 4; it is only read."""
    run_dir = tmp_path_factory.mktemp("trained")
    train(run_dir, 3, seed=4)
    return run_dir


@pytest.fixture
def run_dir(trained, tmp_path):
    """A copy of it."""
    return shutil.copytree(trained, tmp_path / "run")


def options(*args, recipe=RECIPE):
    return options_to_resume(recipe.config, recipe.variant, [str(arg) for arg in args])


def test_a_run_that_goes_on_has_the_options_it_was_started_with(trained):
    assert options("--run-dir", trained, "--resume") == tiny(trained, 3, seed=4)


def test_the_place_is_the_one_on_the_command_line(run_dir):
    moved = run_dir.rename(run_dir.with_name("moved"))
    assert options("--resume", f"--run-dir={moved}").run_dir == moved


@pytest.mark.parametrize("args", [("--run-dir", "X"), (), ("--no-resume",), ("--run-dir",), ("--help",)])
def test_a_command_line_that_begins_a_run_has_the_options_of_the_recipe(args):
    assert options(*args) is None


def test_resuming_where_there_is_nothing_has_the_options_of_the_recipe(tmp_path):
    assert options("--run-dir", tmp_path / "nothing", "--resume") is None


def test_a_run_killed_before_its_first_checkpoint_keeps_its_options(run_dir):
    shutil.rmtree(run_dir / "checkpoints")
    assert options("--run-dir", run_dir, "--resume").seed == 4


@pytest.mark.parametrize("content", [None, "", "{", '{"config": {"speed": 4}}', '{"config": {"num_envs": 1e9}}'])
def test_without_a_readable_configuration_the_options_are_those_of_the_checkpoint(run_dir, content, capsys):
    (run_dir / "config.json").unlink()
    if content is not None:
        (run_dir / "config.json").write_text(content)
    assert options("--run-dir", run_dir, "--resume") == tiny(run_dir, 3, seed=4)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"{run_dir / 'config.json'} cannot be read; the options are taken from checkpoint-")


def test_a_named_checkpoint_brings_its_own_options(trained, tmp_path):
    path = find_checkpoint(trained)
    assert options("--resume-from", path, "--run-dir", tmp_path) == tiny(tmp_path, 3, seed=4)


def test_a_run_of_another_variant_is_refused(trained):
    with pytest.raises(CheckpointMismatch, match=r"config\.json is of variant 's_push'; expected 'st_push'"):
        options("--run-dir", trained, "--resume", recipe=OTHER)
    with pytest.raises(CheckpointMismatch, match=r"is of variant 's_push'; expected 'st_push'"):
        options("--resume-from", find_checkpoint(trained), recipe=OTHER)


# -- the command line --------------------------------------------------------------------------------------------------


def test_resuming_needs_no_option_typed_again_and_takes_a_larger_budget(run_dir):
    RECIPE.main(["--run-dir", str(run_dir), "--resume", "--ppo.total-control-steps", str(5 * BATCH)])
    assert read_scalar(run_dir, "reward")[0].tolist() == [BATCH * k for k in range(1, 6)]
    record = json.loads((run_dir / "config.json").read_text())["config"]
    assert (record["seed"], record["num_envs"], record["ppo"]["total_control_steps"]) == (4, 2, 5 * BATCH)
    assert checkpoint_info(find_checkpoint(run_dir))["config"] == {k: v for k, v in record.items() if k != "variant"}
    assert "resume_from" not in record


def test_another_value_of_an_option_is_refused_with_both_values(run_dir, capsys):
    with pytest.raises(SystemExit) as end:
        RECIPE.main(["--run-dir", str(run_dir), "--resume", "--seed", "5", "--ppo.clip", "0.1"])
    assert end.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "other values of seed (4 then, 5 now), ppo.clip (0.2 then, 0.1 now); expected the same as then" in line
    assert "--resume takes those of the run" in line


def test_threads_may_be_others(run_dir):
    RECIPE.main(["--run-dir", str(run_dir), "--resume", "--num-threads", "2"])
    assert json.loads((run_dir / "config.json").read_text())["config"]["num_threads"] == 2


def test_a_checkpoint_is_named_on_the_command_line(run_dir):
    older = all_checkpoints(run_dir)[-1]
    RECIPE.main(["--run-dir", str(run_dir), "--resume-from", str(older)])
    assert read_scalar(run_dir, "reward")[0].tolist() == [BATCH, 2 * BATCH, 3 * BATCH]


def test_resuming_in_an_empty_directory_begins_a_run(tmp_path):
    RECIPE.main(["--run-dir", str(tmp_path), "--resume", *OPTIONS, "--ppo.total-control-steps", str(BATCH)])
    assert read_scalar(tmp_path, "reward")[0].tolist() == [BATCH]
