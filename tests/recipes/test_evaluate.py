from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import evaluate
import ppo_ppt_push as recipe
import pytest
import torch
from registry import load_policy
from torchrl.checkpoint import Checkpoint

from ppt_rl.envs.mujoco_imports import rendering_backend
from ppt_rl.evaluation import REPORTED
from ppt_rl.training import CheckpointMismatch, PPOConfig, load_checkpoint

KEYS = ["success", "max_power", "jerk_rms", "wrench_p95", "overload_ratio", "contact_continuity", "progress"]


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Checkpoint of a run of two tiny batches."""
    ppo = PPOConfig(total_control_steps=160, epochs=1, minibatches=1)
    run_dir = tmp_path_factory.mktemp("run")
    return recipe.main(
        recipe.Config(run_dir=run_dir, num_envs=4, num_threads=1, duration=0.2, physics_dt=0.002, num_basis=4, ppo=ppo)
    )


def test_the_last_line_is_json_with_the_promised_keys_and_ratios(trained, root):
    run = subprocess.run(
        [sys.executable, "recipes/evaluate.py", str(trained), "--episodes", "6", "--seed", "5", "--json"],
        cwd=root, capture_output=True, text=True,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    report = json.loads(run.stdout.splitlines()[-1])
    assert list(report) == KEYS == list(REPORTED)
    for name, unit in REPORTED.items():
        low, high = report[name]["ci95"]
        assert low <= report[name]["mean"] <= high
        if unit == "0-1":
            assert 0 <= low <= high <= 1


def test_a_report_holds_table_episodes_plots_and_video(trained, tmp_path):
    run = evaluate.Config(trained, episodes=4, num_envs=4, per_box=True, baseline=True, report=tmp_path)
    evaluate.main(run)
    names = {"evaluation.md", "evaluation.json", "episodes.csv", "episode.png", "training.png"}
    if rendering_backend() != "disable":
        names.add("push.mp4")
    assert names <= {path.name for path in tmp_path.iterdir()}
    assert len((tmp_path / "episodes.csv").read_text().splitlines()) == 1 + 6 * 4
    assert len(json.loads((tmp_path / "evaluation.json").read_text())) == 6


def test_evaluation_repeats_with_the_same_seed(trained, tmp_path):
    results = []
    for name in ("a", "b"):
        evaluate.main(evaluate.Config(trained, episodes=4, num_envs=4, seed=7, report=tmp_path / name))
        results.append((tmp_path / name / "episodes.csv").read_text())
    assert results[0] == results[1]


def test_without_an_opengl_library_only_the_video_is_left_out(trained, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("ppt_rl.envs.rendering.rendering_backend", lambda: "disable")
    evaluate.main(evaluate.Config(trained, episodes=2, num_envs=2, report=tmp_path))
    assert "no video: rendering needs an OpenGL library" in capsys.readouterr().out
    assert (tmp_path / "episode.png").exists()
    assert not (tmp_path / "push.mp4").exists()


def test_the_evaluated_environment_has_no_privileged_observation(trained):
    env = load_policy(trained).make_env(num_envs=2, seed=0)
    assert "box_pose" not in env.reset().keys()


def test_a_truncated_checkpoint_is_refused(trained, tmp_path):
    damaged = tmp_path / trained.name
    damaged.write_bytes(trained.read_bytes()[:-2000])
    with pytest.raises(CheckpointMismatch, match="may be truncated"):
        evaluate.main(evaluate.Config(damaged))


def test_a_flipped_byte_is_noticed(trained, tmp_path):
    content = bytearray(trained.read_bytes())
    content[len(content) // 2] ^= 0xFF
    damaged = tmp_path / trained.name
    damaged.write_bytes(content)
    with pytest.raises(CheckpointMismatch):
        evaluate.main(evaluate.Config(damaged))


def test_a_checkpoint_of_another_variant_is_refused(tmp_path):
    path = tmp_path / "other.torchrl"
    metadata = {"variant": "other_task", "config": {}, "success": 0.0}
    Checkpoint(format="archive", actor=torch.nn.Linear(1, 1)).save(path, metadata=metadata)
    with pytest.raises(CheckpointMismatch, match=r"'other_task' is unknown; expected one of .*'ppt_push'"):
        evaluate.main(evaluate.Config(path))


def test_a_checkpoint_of_another_network_is_refused(trained, tmp_path):
    other = recipe.main(
        replace(
            recipe.Config(run_dir=tmp_path, num_envs=4, num_threads=1, duration=0.2, physics_dt=0.002, num_basis=5),
            ppo=PPOConfig(total_control_steps=80, epochs=1, minibatches=1),
        )
    )
    policy = load_policy(trained)
    with pytest.raises(CheckpointMismatch, match="does not fit"):
        load_checkpoint(other, {"actor": policy.actor, **policy.modules})


def test_a_missing_checkpoint_is_named(tmp_path):
    with pytest.raises(CheckpointMismatch, match="does not exist"):
        evaluate.main(evaluate.Config(tmp_path / "nothing.torchrl"))


def test_a_film_of_no_episodes_is_an_error(trained):
    with pytest.raises(ValueError, match="film is 0"):
        evaluate.Config(trained, film=0)


def test_no_episodes_is_an_error(trained):
    with pytest.raises(ValueError, match="expected at least 1"):
        evaluate.main(evaluate.Config(trained, episodes=0))
