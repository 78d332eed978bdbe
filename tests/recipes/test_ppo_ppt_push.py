from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ppt_rl.recipes.ppo_ppt_push import RECIPE, Config
from ppt_rl.training import VALIDATED, CheckpointMismatch, PPOConfig, find_checkpoint
from ppt_rl.training.logs import read_scalar

BATCH = 4 * 20  # control steps of a batch: environments times steps of an episode
LOGGED = ("reward", "loss_objective", "loss_critic", "kl", "max_power", "jerk_rms")


def tiny(run_dir: Path, **changes: object) -> Config:
    ppo = PPOConfig(total_control_steps=3 * BATCH, epochs=2, minibatches=2, checkpoint_every=1)
    config = Config(run_dir=run_dir, num_envs=4, num_threads=1, duration=0.2, physics_dt=0.002, num_basis=4, ppo=ppo)
    return replace(config, **changes)


def scalars(run_dir: Path) -> np.ndarray:
    return np.stack([read_scalar(run_dir, name)[1] for name in LOGGED])


def test_training_writes_checkpoints_logs_and_a_config_with_versions(tmp_path):
    path = RECIPE.train(tiny(tmp_path))
    assert path == find_checkpoint(tmp_path)
    assert read_scalar(tmp_path, "success")[0].tolist() == [BATCH, 2 * BATCH, 3 * BATCH]
    record = json.loads((tmp_path / "config.json").read_text())
    assert record["config"]["seed"] == 0
    assert record["versions"]["torch"]
    assert list((tmp_path / "logs" / "tensorboard").glob("events*"))


def test_the_same_seed_gives_the_same_three_iterations_and_another_seed_others(tmp_path):
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        RECIPE.train(tiny(tmp_path / name, seed=seed))
    assert np.array_equal(scalars(tmp_path / "a"), scalars(tmp_path / "b"))
    assert not np.array_equal(scalars(tmp_path / "a"), scalars(tmp_path / "c"))


def test_the_policy_is_validated_before_training_and_then_every_so_many_batches(tmp_path):
    RECIPE.train(tiny(tmp_path, validate_every=2))
    for name in VALIDATED:
        assert read_scalar(tmp_path, name)[0].tolist() == [0, 2 * BATCH]


def test_a_run_learns_the_same_with_and_without_validation(tmp_path):
    for name, every in (("without", 0), ("with", 1)):
        RECIPE.train(tiny(tmp_path / name, validate_every=every))
    assert np.array_equal(scalars(tmp_path / "with"), scalars(tmp_path / "without"))
    assert not (tmp_path / "without" / "logs" / "csv" / "scalars" / f"{VALIDATED[0]}.csv").exists()


def test_every_validation_has_the_same_episodes(tmp_path):
    config = tiny(tmp_path, validate_every=1, validation_episodes=6)
    modules = RECIPE.make_modules(config)
    RECIPE.fit(config, **modules)
    actor, _ = RECIPE.make_policy(config, RECIPE.make_env(config, modules, num_envs=4))
    first, second = (RECIPE._validation(config, modules, actor) for _ in range(2))
    measured = first.measure()
    assert measured["validation_max_power"] > 0
    assert measured == first.measure() == second.measure()


def test_a_run_that_goes_on_is_validated_at_the_same_batches(tmp_path):
    config = tiny(tmp_path, validate_every=2)
    RECIPE.train(replace(config, ppo=replace(config.ppo, total_control_steps=BATCH)))
    RECIPE.train(replace(config, resume=True))
    assert read_scalar(tmp_path, VALIDATED[0])[0].tolist() == [0, 2 * BATCH]


@pytest.mark.parametrize("replan_steps", [5, 7])
def test_training_replans_within_an_episode(tmp_path, replan_steps):
    RECIPE.train(tiny(tmp_path, replan_steps=replan_steps))
    assert np.isfinite(scalars(tmp_path)).all()
    assert read_scalar(tmp_path, "success")[0][0] == BATCH


def test_a_run_continues_from_its_checkpoint_to_its_budget(tmp_path):
    config = tiny(tmp_path)
    RECIPE.train(replace(config, ppo=replace(config.ppo, total_control_steps=BATCH)))
    RECIPE.train(replace(config, resume=True))
    assert read_scalar(tmp_path, "reward")[0].tolist() == [BATCH, 2 * BATCH, 3 * BATCH]


def test_a_run_killed_in_training_resumes_and_ends(tmp_path, root):
    command = [
        sys.executable, "recipes/ppo_ppt_push.py", "--run-dir", str(tmp_path), "--num-envs", "4", "--num-threads", "1",
        "--duration", "0.2", "--physics-dt", "0.002", "--num-basis", "4", "--ppo.epochs", "2", "--ppo.minibatches", "2",
        "--ppo.checkpoint-every", "1",
    ]  # fmt: skip
    endless = subprocess.Popen(
        [*command, "--ppo.total-control-steps", "100000000"], cwd=root, stderr=subprocess.DEVNULL
    )
    deadline = time.monotonic() + 120
    while len(list((tmp_path / "checkpoints").glob("*.torchrl"))) < 2 and time.monotonic() < deadline:
        time.sleep(0.05)
    endless.send_signal(signal.SIGKILL)
    endless.wait()
    step = int(find_checkpoint(tmp_path).stem.split("-")[-1])
    assert step >= BATCH
    budget = step + 2 * BATCH
    done = subprocess.run(
        [*command, "--ppo.total-control-steps", str(budget), "--resume"], cwd=root, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    steps = read_scalar(tmp_path, "reward")[0]
    assert steps[-1] == budget
    assert np.array_equal(steps, np.arange(1, len(steps) + 1) * BATCH)


def test_interrupting_a_run_leaves_a_checkpoint_and_exits_with_130(tmp_path, root):
    run = subprocess.Popen(
        [sys.executable, "recipes/ppo_ppt_push.py", "--run-dir", str(tmp_path), "--num-envs", "4", "--duration", "0.2",
         "--physics-dt", "0.002", "--ppo.checkpoint-every", "1000000"],
        cwd=root, stderr=subprocess.PIPE, text=True, env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )  # fmt: skip
    deadline = time.monotonic() + 120
    while not (tmp_path / "logs" / "csv" / "scalars" / "success.csv").exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    run.send_signal(signal.SIGINT)
    _, stderr = run.communicate(timeout=60)
    assert run.returncode == 130
    assert "--resume" in stderr
    assert "Traceback" not in stderr
    assert find_checkpoint(tmp_path).exists()


def test_a_directory_that_holds_a_run_is_refused_unless_resumed(tmp_path):
    RECIPE.train(tiny(tmp_path))
    with pytest.raises(CheckpointMismatch, match=r"holds a run already.*--resume"):
        RECIPE.train(tiny(tmp_path))


def test_resuming_with_another_configuration_names_what_differs(tmp_path):
    RECIPE.train(tiny(tmp_path))
    with pytest.raises(CheckpointMismatch, match="other values of p_max"):
        RECIPE.train(tiny(tmp_path, resume=True, p_max=1.0))


def test_resuming_where_there_is_no_checkpoint_starts_afresh_and_says_so(tmp_path, capfd):
    RECIPE.train(tiny(tmp_path, resume=True))
    assert f"{tmp_path} holds no checkpoint yet: the run starts afresh." in capfd.readouterr().err.splitlines()
    assert read_scalar(tmp_path, "success")[0].tolist() == [BATCH, 2 * BATCH, 3 * BATCH]


def test_a_wrong_option_ends_with_advice_and_no_traceback(tmp_path, root):
    run = subprocess.run(
        [sys.executable, "recipes/ppo_ppt_push.py", "--run-dir", str(tmp_path), "--physics-dt", "0.003"],
        cwd=root, capture_output=True, text=True,
    )  # fmt: skip
    assert run.returncode == 2
    assert "physics_dt=0.003" in run.stderr
    assert "expected a whole number" in run.stderr
    assert "Traceback" not in run.stderr
