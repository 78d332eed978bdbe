from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch

from ppt_rl.envs import MazeLayout, Straight, Turn
from ppt_rl.envs.mujoco_imports import rendering_backend
from ppt_rl.evaluation import (
    Policy,
    Study,
    evaluate,
    find_recipe,
    load_policy,
    record_episodes,
    run_study,
    run_sweep,
    shipped_recipes,
)
from ppt_rl.evaluation.drawing import draw_policy
from ppt_rl.recipes import ppo_ppt_maze, ppo_ppt_sharp_maze
from ppt_rl.tasks.maze import MAZE, fit_maze_prior, make_test_env, make_training_env
from ppt_rl.training import CheckpointMismatch

#: The tank at the motors stands first, the paper's after the wrench.
CONTROL = [
    "EnergyTankTransform", "JointTorqueTransform", "EnergyTankTransform", "ImpedanceTransform",
    "EpisodeMetricsTransform",
]  # fmt: skip
CHAINS = {
    "ppt_maze": [
        *CONTROL, "HeadingFrameTransform", "ContactViaPointTransform", "MacroStepTransform", "RecedingProMPTransform",
        "ViaPointTransform",
    ],
    "ppt_sharp_maze": [
        *CONTROL, "HeadingFrameTransform", "MotionMemoryTransform", "ContactViaPointTransform", "MacroStepTransform",
        "RecedingProMPTransform", "ViaPointTransform", "ActionMapTransform",
    ],
    "st_maze": [*CONTROL, "HeadingFrameTransform", "CartesianVelocityTransform"],
}  # fmt: skip
variants = pytest.mark.parametrize("variant", sorted(CHAINS))
SETTINGS = {
    "num_envs": "2", "num_threads": "1", "duration": "0.4", "training_duration": "0.4", "physics_dt": "0.002",
    "ppo.total_control_steps": "256",
}  # fmt: skip
QUICK = {"duration": 0.4, "physics_dt": 0.002, "num_threads": 1}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Study:
    """A study of a few frames of both variants, its prior fitted to few demonstrations."""
    place = tmp_path_factory.mktemp("maze")
    study = Study(
        [find_recipe(variant) for variant in CHAINS], seeds=1, runs=place / "runs", results=place / "results",
        publish=place / "published", episodes=2, num_envs=2, settings=SETTINGS,
    )  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        for recipe in (ppo_ppt_maze, ppo_ppt_sharp_maze):
            patch.setattr(recipe, "fit_maze_prior", partial(fit_maze_prior, num_corridors=6))
        run_study(study)
    return study


@pytest.fixture(scope="module")
def policies(finished: Study) -> dict[str, Policy]:
    return {run.recipe.variant: load_policy(run.run_dir) for run in finished.planned()}


def test_every_maze_recipe_is_tested():
    assert sorted(CHAINS) == sorted(name for name in shipped_recipes() if find_recipe(name).task is MAZE)


@variants
def test_the_chain_is_the_list_of_the_recipe_and_only_the_test_hides_more(policies, variant):
    policy = policies[variant]
    env = policy.make_env(num_envs=1, seed=0)
    assert [type(part).__name__ for part in env.transform] == [*CHAINS[variant], "ExcludeTransform"]
    assert not {"corridor_offset", "corridor_heading"} & set(env.observation_spec.keys())
    env.close()


@variants
def test_training_sees_straight_corridors_only_but_for_sharp_turns_and_the_test_turns(policies, variant):
    policy, in_corridors = policies[variant], variant != "ppt_sharp_maze"
    training = make_training_env(policy.config, num_envs=3, seed=1)
    test = policy.make_env(num_envs=3, seed=1)
    for _ in range(5):
        training.reset()
        assert all(layout.is_straight == in_corridors for layout in training.layouts)
    test.reset()
    assert not set(map(str, training.layouts)) & set(map(str, test.base_env.layouts))
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
        assert load_policy(finished.publish / run.recipe.variant).variant == run.recipe.variant


def test_the_evaluation_puts_the_baselines_into_the_same_mazes(policies):
    result = evaluate(policies["ppt_maze"], episodes=2, seed=3, baselines=True)
    assert list(result.rows) == ["ppt_maze", "reference alone", "wall follower"]
    assert set(result.as_json()["baselines"]["wall follower"]) == set(MAZE.report.columns)
    assert "wall follower" in result.tables()
    assert list(evaluate(policies["st_maze"], episodes=1, seed=3, baselines=True).rows) == ["st_maze", "wall follower"]


def test_a_second_pass_filters_the_same_episodes_more(policies):
    rows = evaluate(policies["ppt_maze"], episodes=2, seed=3).rows["ppt_maze"]["all"]
    assert (rows["jerk_rms_slow"] < rows["jerk_rms"]).all()


def test_a_slower_follower_leaves_the_policy_alone(policies):
    policy = policies["ppt_maze"]
    slow, usual = (
        evaluate(policy.with_changes(follower_speed=speed), episodes=2, seed=3, baselines=True).rows
        for speed in (0.02, 0.055)
    )
    assert (slow["wall follower"]["all"]["progress"] < usual["wall follower"]["all"]["progress"]).all()
    for name in ("ppt_maze", "reference alone"):
        np.testing.assert_array_equal(slow[name]["all"]["jerk_rms"], usual[name]["all"]["jerk_rms"])


@pytest.mark.parametrize("speed", [0.0, -0.05, math.nan, math.inf])
def test_an_impossible_speed_of_the_follower_is_refused(speed):
    with pytest.raises(ValueError, match=r"follower_speed is .*; expected a number from 0.0001 to 10 m/s"):
        find_recipe("ppt_maze").config(follower_speed=speed)


def test_a_maze_of_ones_own_is_evaluated_and_drawn(policies, tmp_path):
    layout = MazeLayout((Straight(0.12), Turn(0.5), Straight(0.12)), start=(0.5, -0.1))
    (tmp_path / "mine.json").write_text(layout.to_json())
    policy = policies["ppt_maze"].with_changes(layouts=(tmp_path / "mine.json",))
    env = policy.make_env(1)
    env.reset()
    assert env.base_env.layouts == [layout]
    draw_policy(policy, tmp_path / "report", episodes=1, seed=0)
    assert (tmp_path / "report" / "episode.png").exists()
    assert (tmp_path / "report" / "ppt_maze.mp4").exists() == (rendering_backend() != "disable")


def test_a_changed_checkpoint_is_refused(finished, tmp_path):
    source = finished.publish / "ppt_maze"
    for path in source.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    weights = tmp_path / "policy.safetensors"
    weights.write_bytes(weights.read_bytes()[:-8] + b"tampered")
    with pytest.raises(CheckpointMismatch):
        load_policy(tmp_path)


def test_difficulty_is_swept_and_drawn(policies, tmp_path, monkeypatch):
    points = MAZE.sweep.points(1, 5)
    chosen = [point for point in points if point.quantity in ("turns [degrees]", "width [mm]")][:8]
    few = replace(MAZE.sweep, points=lambda count, seed: chosen)
    task = replace(MAZE, sweep=few)
    studied = [policy for policy in policies.values() if policy.recipe.in_study]
    swept = [replace(policy, recipe=replace(policy.recipe, task=task)) for policy in studied]
    run_sweep(swept, episodes=1, seed=5, baselines=["wall follower"], report=tmp_path)
    curves = json.loads((tmp_path / "difficulty.json").read_text())
    assert set(curves["turns [degrees]"]) == {"PPT", "ST", "wall follower"}
    assert len(curves["turns [degrees]"]["PPT"][0]) == 6
    assert (tmp_path / "difficulty.png").stat().st_size > 5_000


def test_the_prior_goes_straight_ahead_on_the_floor():
    recipe = find_recipe("ppt_maze")
    config = recipe.config(num_threads=1, physics_dt=0.002)
    promp = fit_maze_prior(recipe.make_modules(config)["promp"], config, num_corridors=8, seed=3)
    position, velocity, _ = promp.decode(promp.weights_mean, torch.linspace(0.0, 1.0, 9))
    assert velocity[:, 0].min() > 0.6 * config.follower_speed
    assert position[:, 1].abs().max() < 0.01  # to the side, over some 5 cm
    torch.testing.assert_close(position[:, 2], torch.full((9,), -config.depth), atol=1.5e-3, rtol=0.0)


def test_a_recorded_rollout_holds_the_via_points_of_touch(policies):
    policy = policies["ppt_maze"]
    env = policy.make_env(num_envs=2, seed=0)
    episode = record_episodes(env, policy.actor, ("pose", "via_position", "via_mask"))
    steps = int(episode["control_steps"].max())
    assert episode["trace", "via_position"].shape[-2:] == (8, 3)
    assert episode["trace", "pose"].shape[1] >= steps
    env.close()


def test_the_bare_environment_of_the_recipes_takes_the_time_of_training_or_test():
    config = find_recipe("st_maze").config(num_threads=1)
    assert make_training_env(config, num_envs=1).duration == config.training_duration
    assert make_test_env(config, num_envs=1).duration == config.duration
    with pytest.raises(ValueError, match="training corridors are drawn"):
        make_training_env(config, num_envs=1, given=[MazeLayout((Straight(0.2),), start=(0.5, 0.0))])


@variants
def test_a_policy_does_to_the_right_what_it_does_to_the_left(variant, policies):
    policy = policies[variant]
    env = policy.make_env(num_envs=4, seed=0)
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


def test_a_policy_that_decides_a_velocity_has_three_numbers_to_decide_and_the_same_reference():
    weights, velocity = (find_recipe(name) for name in ("ppt_maze", "ppt_sharp_maze"))
    here = velocity.config(**QUICK)
    there = weights.config(max_lead=here.max_lead, mazes=here.mazes, **QUICK)
    modules = weights.make_modules(there)
    modules["promp"].weights_mean[:, 0] = 0.05 * modules["promp"].centres
    ends = []
    for recipe, config, size in ((weights, there, 24), (velocity, here, 3)):
        env = recipe.make_env(config, modules, num_envs=2, seed=0)
        assert env.full_action_spec["action"].shape == (2, size)
        steps = env.step(env.reset().set("action", torch.zeros(2, size)))
        ends.append(steps["next", "reference_position"])
        env.close()
    torch.testing.assert_close(*ends)
