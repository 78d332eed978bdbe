from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torchrl.checkpoint import Checkpoint

from ppt_rl.envs.mujoco_imports import rendering_backend
from ppt_rl.evaluation import COLUMNS, evaluate, load_policy
from ppt_rl.evaluation.drawing import draw_policy, film
from ppt_rl.recipes.ppo_ppt_push import RECIPE, Config
from ppt_rl.training import CheckpointMismatch, PPOConfig, load_checkpoint


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Checkpoint of a run of two tiny batches."""
    ppo = PPOConfig(total_control_steps=160, epochs=1, minibatches=1)
    run_dir = tmp_path_factory.mktemp("run")
    return RECIPE.train(
        Config(run_dir=run_dir, num_envs=4, num_threads=1, duration=0.2, physics_dt=0.002, num_basis=4, ppo=ppo)
    )


def test_the_json_has_the_promised_metrics_and_the_baselines_by_name(trained):
    result = evaluate(load_policy(trained), episodes=6, seed=5, baselines=True).as_json()
    assert list(result) == [*COLUMNS, "baselines"]
    assert list(result["baselines"]) == ["reference alone", "naive reference"]
    for row in (result, result["baselines"]["reference alone"]):
        for name, column in COLUMNS.items():
            low, high = row[name]["ci95"]
            assert low <= row[name]["mean"] <= high
            if column.unit == "0-1":
                assert 0 <= low <= high <= 1


def test_without_baselines_the_json_has_metrics_only(trained):
    assert list(evaluate(load_policy(trained), episodes=2, seed=5).as_json()) == list(COLUMNS)


def test_a_report_holds_a_row_for_each_actor_group_and_episode(trained, tmp_path):
    result = evaluate(load_policy(trained), episodes=4, seed=1, num_envs=4, groups=True, baselines=True)
    result.write(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {
        "evaluation.md", "evaluation.json", "audit.json", "episodes.csv",
    }  # fmt: skip
    assert len((tmp_path / "episodes.csv").read_text().splitlines()) == 1 + 9 * 4
    labels = list(json.loads((tmp_path / "evaluation.json").read_text()))
    assert labels == [
        "ppt_push", "ppt_push, 6 cm", "ppt_push, 8 cm",
        "reference alone", "reference alone, 6 cm", "reference alone, 8 cm",
        "naive reference", "naive reference, 6 cm", "naive reference, 8 cm",
    ]  # fmt: skip


def test_a_group_holds_its_kind_of_episode_only(trained):
    result = evaluate(load_policy(trained), episodes=4, seed=1, groups=True, everything=False)
    assert list(result.rows["ppt_push"]) == ["6 cm", "8 cm"]
    for label, size in (("6 cm", 0.06), ("8 cm", 0.08)):
        np.testing.assert_allclose(result.rows["ppt_push"][label]["box_size"], size, rtol=1e-6)


def test_a_policy_with_one_kind_of_box_is_judged_in_all_episodes(trained):
    policy = load_policy(trained).with_changes(box_sizes=(0.06,))
    result = evaluate(policy, episodes=2, seed=1, groups=True, everything=False)
    assert list(result.rows["ppt_push"]) == ["all"]


def test_figures_of_an_evaluation_are_an_episode_the_training_and_a_video(trained, tmp_path, capsys):
    draw_policy(load_policy(trained), tmp_path, episodes=2, seed=1)
    names = {"episode.png", "training.png"} | ({"ppt_push.mp4"} if rendering_backend() != "disable" else set())
    assert {path.name for path in tmp_path.iterdir()} == names
    assert "video" in capsys.readouterr().out


def test_evaluation_repeats_with_the_same_seed(trained):
    policy = load_policy(trained)
    first, second = (evaluate(policy, episodes=4, seed=7, num_envs=4).labelled["ppt_push"] for _ in range(2))
    for name, values in first.items():
        np.testing.assert_array_equal(values, second[name])


def test_several_seeds_share_the_episodes_and_each_gives_its_own(trained):
    policy = load_policy(trained)
    both = evaluate(policy, episodes=5, seed=(7, 8), num_envs=2).labelled["ppt_push"]
    first, second = (
        evaluate(policy, episodes=n, seed=seed, num_envs=2).labelled["ppt_push"] for n, seed in ((3, 7), (2, 8))
    )
    assert all(np.array_equal(both[name], np.concatenate([first[name], second[name]])) for name in both)


@pytest.mark.parametrize("seeds", [(), (7, 8, 7)])
def test_no_seed_and_the_same_seed_twice_are_refused(trained, seeds):
    with pytest.raises(ValueError, match=r"the seeds of the episodes are .*expected at least one, each of them once"):
        evaluate(load_policy(trained), episodes=4, seed=seeds)


def test_without_an_opengl_library_only_the_video_is_left_out(trained, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("ppt_rl.envs.rendering.rendering_backend", lambda: "disable")
    draw_policy(load_policy(trained), tmp_path, episodes=2, seed=1)
    assert "no video: rendering needs an OpenGL library" in capsys.readouterr().out
    assert (tmp_path / "episode.png").exists()
    assert not (tmp_path / "ppt_push.mp4").exists()


def test_the_evaluated_environment_has_no_privileged_observation(trained):
    env = load_policy(trained).make_env(num_envs=2, seed=0)
    assert "box_pose" not in env.reset().keys()


def test_a_truncated_checkpoint_is_refused(trained, tmp_path):
    damaged = tmp_path / trained.name
    damaged.write_bytes(trained.read_bytes()[:-2000])
    with pytest.raises(CheckpointMismatch, match="may be truncated"):
        load_policy(damaged)


def test_a_flipped_byte_is_noticed(trained, tmp_path):
    content = bytearray(trained.read_bytes())
    content[len(content) // 2] ^= 0xFF
    damaged = tmp_path / trained.name
    damaged.write_bytes(content)
    with pytest.raises(CheckpointMismatch):
        load_policy(damaged)


def test_a_checkpoint_of_another_variant_is_refused(tmp_path):
    path = tmp_path / "other.torchrl"
    metadata = {"variant": "other_task", "config": {}, "success": 0.0}
    Checkpoint(format="archive", actor=torch.nn.Linear(1, 1)).save(path, metadata=metadata)
    with pytest.raises(CheckpointMismatch, match=r"'other_task' is unknown; expected one of .*'ppt_push'"):
        load_policy(path)


def test_a_checkpoint_of_another_network_is_refused(trained, tmp_path):
    config = Config(run_dir=tmp_path, num_envs=4, num_threads=1, duration=0.2, physics_dt=0.002, num_basis=5)
    other = RECIPE.train(replace(config, ppo=PPOConfig(total_control_steps=80, epochs=1, minibatches=1)))
    policy = load_policy(trained)
    with pytest.raises(CheckpointMismatch, match="does not fit"):
        load_checkpoint(other, {"actor": policy.actor, **policy.modules})


def test_a_missing_checkpoint_is_named(tmp_path):
    with pytest.raises(CheckpointMismatch, match="does not exist"):
        load_policy(tmp_path / "nothing.torchrl")


@pytest.mark.parametrize(
    ("episodes", "name", "message"), [(0, "a.mp4", "episodes is 0; expected"), (1, "a.avi", r"ends in \.mp4 or \.gif")]
)
def test_an_impossible_film_is_refused(trained, tmp_path, episodes, name, message):
    with pytest.raises(ValueError, match=message):
        film(load_policy(trained), tmp_path / name, episodes=episodes, seed=0)


def test_no_episodes_is_an_error(trained):
    with pytest.raises(ValueError, match="episodes is 0; expected a whole number from 1 to"):
        evaluate(load_policy(trained), episodes=0, seed=0)
