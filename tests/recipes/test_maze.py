from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import evaluate
import evaluate_maze
import maze_difficulty
import pytest
import study
import torch
from registry import RECIPES, Policy, load_policy, recipe_of

from ppt_rl.envs import MazeLayout, Straight, Turn
from ppt_rl.envs.mujoco_imports import rendering_backend
from ppt_rl.evaluation import record_episodes
from ppt_rl.tasks.maze import fit_maze_prior, make_maze_env
from ppt_rl.training import CheckpointMismatch, PPOConfig

CONTROL = ["JointTorqueTransform", "EnergyTankTransform", "ImpedanceTransform", "EpisodeMetricsTransform"]
CHAINS = {
    "ppt_maze": [
        *CONTROL, "HeadingFrameTransform", "ContactViaPointTransform", "MacroStepTransform", "RecedingProMPTransform",
        "ViaPointTransform",
    ],
    "st_maze": [*CONTROL, "HeadingFrameTransform", "CartesianVelocityTransform"],
}  # fmt: skip
variants = pytest.mark.parametrize("variant", sorted(CHAINS))


def tiny(place: Path, **changes: Any) -> study.Config:
    config = study.Config(
        task="maze", seeds=1, runs=place / "runs", results=place / "results", pretrained=place / "pretrained",
        episodes=2, num_envs=2, num_threads=1, total_control_steps=256, duration=0.4, physics_dt=0.002,
    )  # fmt: skip
    return replace(config, **changes)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> study.Config:
    """A study of a few frames of both variants, its prior fitted to few demonstrations."""
    config = tiny(tmp_path_factory.mktemp("maze"))
    few = partial(fit_maze_prior, num_corridors=6)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ppo_ppt_maze.fit_maze_prior", few)
        patch.setattr("study_maze.fit_maze_prior", few)
        study.main(config)
    return config


@pytest.fixture(scope="module")
def policies(finished: study.Config) -> dict[str, Policy]:
    return {run.variant: load_policy(run.run_dir) for run in finished.planned()}


def test_every_maze_recipe_is_tested():
    assert sorted(CHAINS) == sorted(name for name in RECIPES if name.endswith("_maze"))


@variants
def test_the_chain_is_the_list_of_the_recipe_and_only_the_test_hides_more(policies, variant):
    policy = policies[variant]
    env = policy.make_env(num_envs=1, seed=0)
    assert [type(part).__name__ for part in env.transform] == [*CHAINS[variant], "ExcludeTransform"]
    assert not {"corridor_offset", "corridor_heading"} & set(env.observation_spec.keys())
    env.close()


@variants
def test_training_sees_straight_corridors_only_and_the_test_turns(policies, variant):
    policy = policies[variant]
    training = policy.recipe.make_env(policy.config, *policy.modules.values(), num_envs=3, seed=1)
    test = policy.make_env(num_envs=3, seed=1)
    for _ in range(5):
        training.reset()
        assert all(layout.is_straight for layout in training.base_env.layouts)
    test.reset()
    assert not any(layout.is_straight for layout in test.base_env.layouts)
    training.close()
    test.close()


@variants
def test_a_policy_reads_neither_map_nor_progress(policies, variant):
    read = set(policies[variant].actor.in_keys)
    assert not read & {"corridor_offset", "corridor_heading", "progress", "pose", "start_heading"}
    assert {"heading_twist", "heading_wrench"} <= read


def test_a_study_leaves_tables_figures_and_policies(finished):
    names = {path.name for path in finished.results_dir.iterdir()}
    assert {
        "tables.md", "summary.json", "training.png", "paper_maze.png", "rollouts.png", "metrics.png", "prior.png",
    } <= names  # fmt: skip
    text = (finished.results_dir / "tables.md").read_text()
    assert all(words in text for words in ("real robot", "wall follower", "reference alone"))
    for run in finished.planned():
        assert load_policy(finished.pretrained / run.variant).variant == run.variant


def test_a_finished_maze_run_is_not_repeated(finished, capsys):
    study.main(finished)
    assert "run 1" not in capsys.readouterr().out


def test_the_evaluation_puts_the_baselines_into_the_same_mazes(finished, tmp_path, capsys):
    run = finished.planned()[0]
    setup = evaluate_maze.Config(run.run_dir, mazes=2, num_envs=2, num_threads=1, baseline=True, report=tmp_path)
    evaluate_maze.main(setup)
    rows = json.loads((tmp_path / "evaluation.json").read_text())
    assert list(rows) == ["ppt_maze", "reference alone", "wall follower"]
    assert set(rows["wall follower"]) == set(evaluate_maze.COLUMNS)
    assert "wall follower" in capsys.readouterr().out


def test_a_slower_follower_leaves_the_policy_alone(finished):
    policy = load_policy(finished.planned()[0].run_dir)
    setup = evaluate_maze.Config(Path(), mazes=2, num_envs=2, num_threads=1, baseline=True, follower_speed=0.02)
    slow, usual = (evaluate_maze.evaluate(policy, run) for run in (setup, replace(setup, follower_speed=0.055)))
    assert (slow["wall follower"]["progress"] < usual["wall follower"]["progress"]).all()
    for name in ("ppt_maze", "reference alone"):
        assert (slow[name]["jerk_rms"] == usual[name]["jerk_rms"]).all()


@pytest.mark.parametrize("speed", [0.0, -0.05, math.nan, math.inf])
def test_an_impossible_speed_of_the_follower_is_refused(speed):
    with pytest.raises(ValueError, match=r"follower_speed is .*; expected a speed above 0 m/s"):
        evaluate_maze.Config(Path(), follower_speed=speed)


def test_a_maze_of_ones_own_is_evaluated_and_filmed(finished, tmp_path):
    layout = MazeLayout((Straight(0.12), Turn(0.5), Straight(0.12)), start=(0.5, -0.1))
    (tmp_path / "mine.json").write_text(layout.to_json())
    run = finished.planned()[0]
    film = tmp_path / "film.mp4"
    evaluate_maze.main(
        evaluate_maze.Config(run.run_dir, layout=(tmp_path / "mine.json",), num_threads=1, json=True, video=film)
    )
    assert film.exists() == (rendering_backend() != "disable")


def test_either_evaluation_sends_the_other_tasks_policies_on(finished, root):
    with pytest.raises(ValueError, match="evaluate_maze"):
        evaluate.main(evaluate.Config(finished.planned()[0].run_dir))
    with pytest.raises(ValueError, match=r"evaluate\.py"):
        evaluate_maze.main(evaluate_maze.Config(root / "pretrained" / "ppt_push"))


def test_a_changed_checkpoint_is_refused(finished, tmp_path):
    source = finished.pretrained / "ppt_maze"
    for path in source.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    weights = tmp_path / "policy.safetensors"
    weights.write_bytes(weights.read_bytes()[:-8] + b"tampered")
    with pytest.raises(CheckpointMismatch):
        load_policy(tmp_path)


def test_difficulty_is_swept_and_drawn(finished, tmp_path, monkeypatch):
    monkeypatch.setattr(
        maze_difficulty, "SWEEPS", {name: (f, v[:2], u) for name, (f, v, u) in list(maze_difficulty.SWEEPS.items())[:2]}
    )
    paths = tuple(run.run_dir for run in finished.planned())
    maze_difficulty.main(maze_difficulty.Config(paths, mazes=1, num_threads=1, baseline=True, report=tmp_path))
    curves = json.loads((tmp_path / "difficulty.json").read_text())
    assert set(curves["turns [degrees]"]) == {"PPT", "ST", "wall follower"}
    assert (tmp_path / "difficulty.png").stat().st_size > 5_000


def test_the_prior_goes_straight_ahead_on_the_floor():
    recipe = recipe_of("ppt_maze")
    config = recipe.Config(num_threads=1, physics_dt=0.002, ppo=PPOConfig())
    promp = fit_maze_prior(recipe.make_modules(config)["promp"], config, num_corridors=8, seed=3)
    position, velocity, _ = promp.decode(promp.weights_mean, torch.linspace(0.0, 1.0, 9))
    assert velocity[:, 0].min() > 0.6 * config.follower_speed
    assert position[:, 1].abs().max() < 0.01  # to the side, over some 5 cm
    torch.testing.assert_close(position[:, 2], torch.full((9,), -config.depth), atol=1.5e-3, rtol=0.0)


def test_a_recorded_rollout_holds_the_via_points_of_touch(policies):
    policy = policies["ppt_maze"]
    env = policy.make_env(num_envs=2, seed=0, num_threads=1)
    episode = record_episodes(env, policy.actor, ("pose", "via_position", "via_mask"))
    steps = int(episode["control_steps"].max())
    assert episode["trace", "via_position"].shape[-2:] == (8, 3)
    assert episode["trace", "pose"].shape[1] >= steps
    env.close()


def test_the_bare_environment_of_the_recipes_takes_the_time_of_training_or_test():
    config = recipe_of("st_maze").Config(num_envs=1, num_threads=1)
    assert make_maze_env(config).duration == config.training_duration
    assert make_maze_env(config, layouts=[MazeLayout((Straight(0.2),), start=(0.5, 0.0))]).duration == config.duration


@variants
def test_a_policy_does_to_the_right_what_it_does_to_the_left(variant, policies):
    policy = policies[variant]
    env = policy.make_env(num_envs=4, seed=0, num_threads=1)
    here = env.reset().select(*policy.actor.in_keys)
    twist = torch.randn(4, 6)
    here["heading_twist"], here["heading_wrench"] = twist, 3 * twist.roll(1, 0)
    # Seen in a mirror, what points left points right; what turns about the other axes turns round.
    sign = torch.tensor([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
    there = here.clone()
    for key in ("heading_twist", "heading_wrench"):
        there[key] = sign * here[key]
    left, right = (policy.actor.get_dist(td).mean.unflatten(-1, (3, -1)) for td in (here, there))
    torch.testing.assert_close(right, left * sign[:3].unsqueeze(-1))
    assert left[:, 1].abs().max() > 1e-6
    env.close()
