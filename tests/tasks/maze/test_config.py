from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from ppt_rl.envs import MazeEnv, MazeLayout, MazeRanges, MazeRewards, Straight, StraightRanges, Turn
from ppt_rl.evaluation import find_recipe, record_episodes, run_episodes
from ppt_rl.tasks.maze import (
    RecedingConfig,
    StepWiseMazeConfig,
    fit_maze_prior,
    make_follower,
    make_follower_env,
    make_maze_promp,
    make_test_env,
    make_training_env,
    maze_metrics,
    velocity_map,
)
from ppt_rl.training import as_json, from_json, with_settings

CONFIG = RecedingConfig(num_envs=2, num_threads=1, physics_dt=0.002, seed=3)


def test_training_and_test_are_built_from_the_same_options_but_for_mazes_and_time():
    training, test = (make(CONFIG, num_envs=2, seed=3) for make in (make_training_env, make_test_env))
    training.reset()
    test.reset()
    assert training.duration == CONFIG.training_duration
    assert test.duration == CONFIG.duration
    assert [layout.is_straight for layout in (*training.layouts, *test.layouts)] == [True, True, False, False]
    assert training.engine_config.physics_dt == test.engine_config.physics_dt == CONFIG.physics_dt


def test_training_in_mazes_meets_mazes_of_the_test_s_ranges_but_none_of_the_test():
    sharp = MazeRanges(turn=(1.2, 1.25), turns=(1, 1), length=(0.6, 0.7))
    config = replace(CONFIG, train_in="mazes", mazes=sharp)
    training, test = (make(config, num_envs=2, seed=3) for make in (make_training_env, make_test_env))
    for env in (training, test):
        env.reset()
        turns = [abs(s.angle) for layout in env.layouts for s in layout.segments if isinstance(s, Turn)]
        assert len(turns) == 2
        assert all(1.2 <= angle <= 1.25 for angle in turns)
    assert training.layouts != test.layouts
    assert training.duration == config.training_duration


def test_corridors_have_the_ranges_of_the_options():
    config = replace(CONFIG, corridors=StraightRanges(friction=(0.9, 1.0)))
    env = make_training_env(config, num_envs=2, seed=3)
    env.reset()
    assert all(0.9 <= layout.friction <= 1.0 for layout in env.layouts)


def test_the_weights_of_the_rewards_are_options_and_each_variant_has_its_own():
    config = with_settings(CONFIG, {"rewards.cruise": "0.1", "mazes.turn": "1.2,1.25"})
    assert config.rewards == MazeRewards(cruise=0.1)
    assert from_json(RecedingConfig, as_json(config)) == config
    env = make_training_env(config, num_envs=1, seed=0)
    assert env.rewards == config.rewards
    env.close()
    assert find_recipe("st_maze").config().rewards.progress == 3.0
    assert find_recipe("ppt_maze").config().rewards == MazeRewards()


def test_a_prior_is_fitted_to_corridors_wherever_the_policy_trains():
    priors = []
    for place in ("corridors", "mazes"):
        config = replace(CONFIG, train_in=place)
        priors.append(fit_maze_prior(make_maze_promp(config), config, num_corridors=2).weights_mean)
    assert torch.equal(*priors)


@pytest.mark.parametrize("error", [0.1, 1.3])
def test_the_error_of_the_heading_that_training_tells_is_an_option(error: float):
    env = make_training_env(replace(CONFIG, heading_error=error), num_envs=8, seed=0)
    root = env.reset()
    off = root["start_heading"] - root["corridor_heading"]
    off = torch.atan2(off.sin(), off.cos()).abs()
    assert 0.5 * error < off.max() <= error + 1e-6
    env.close()


def test_by_default_training_tells_the_headings_of_the_environment_s_own_default():
    ours, its = (
        make(num_envs=4, seed=3)
        for make in (
            lambda **kwargs: make_training_env(CONFIG, **kwargs),
            lambda **kwargs: MazeEnv.straight(**kwargs),
        )
    )
    assert ours.randomisation == its.randomisation
    ours.close()
    its.close()


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_policy_that_decides_a_velocity_adds_it_to_that_of_the_primitive(axis: int):
    promp = make_maze_promp(CONFIG).double()
    phase = torch.linspace(0.0, 1.0, 41, dtype=torch.float64)
    decided = torch.eye(3, dtype=torch.float64)[axis]
    weights = (velocity_map(promp) @ decided).reshape(3, CONFIG.num_basis).mT  # axis by axis
    position, velocity, _ = promp.decode(weights, phase)
    along = torch.zeros(41, 3, dtype=torch.float64)
    along[:, axis] = 1.0
    assert (position - phase.unsqueeze(-1) * along).abs().max() < 0.02
    assert (velocity * promp.duration - along).abs().max() < 0.1


def test_an_unknown_training_ground_is_refused():
    with pytest.raises(ValueError, match=r"train_in is 'both'; expected one of \['corridors', 'mazes'\]"):
        replace(CONFIG, train_in="both")


def test_the_straight_line_is_within_the_span_of_the_basis_without_ripple():
    promp = make_maze_promp(CONFIG)
    phase = torch.linspace(0.0, 1.0, 201, dtype=torch.float64)
    basis, slope, _ = promp.basis(phase)
    weights = torch.linalg.lstsq(basis, phase.unsqueeze(-1)).solution
    assert (slope @ weights - 1).abs().max() < 0.02


@pytest.mark.parametrize(("phase", "stable"), [(0.1875, True), (0.025, False)])
def test_the_hand_over_dies_out_at_the_recipes_chunk_and_grows_at_an_eighth_of_it(phase: float, stable: bool):
    promp = make_maze_promp(CONFIG).double()
    assert CONFIG.replan_steps * CONFIG.control_dt / CONFIG.promp_duration == pytest.approx(0.1875)

    def rows(at: float) -> torch.Tensor:
        value, slope, _ = promp.basis(torch.tensor([at], dtype=torch.float64))
        return torch.cat([value, slope])

    carried = rows(phase) @ torch.linalg.pinv(rows(0.0))  # offset and velocity, from one hand-over to the next
    radius = torch.linalg.eigvals(carried).abs().max()
    assert radius == pytest.approx(0.73, abs=0.01) if stable else radius > 1.0


def test_the_follower_reaches_the_end_behind_the_tank_of_the_policies():
    layout = MazeLayout((Straight(0.12),), start=(0.5, -0.06))
    env = make_follower_env(CONFIG, make_test_env(CONFIG, given=[layout], num_envs=1))
    rows = run_episodes(env, make_follower(CONFIG), 1)
    assert rows["success"] == [1.0]
    assert rows["max_power"] <= CONFIG.p_max
    expected = (0.12 - 0.035) / CONFIG.follower_speed / CONFIG.control_dt
    assert rows["control_steps"][0] == pytest.approx(expected, rel=0.3)
    env.close()


def test_every_episode_is_in_a_maze_of_its_own_whoever_ends_first():
    lengths = (0.09, 0.13, 0.12, 0.1)
    layouts = [MazeLayout((Straight(length),), start=(0.5, -0.06)) for length in lengths]
    env = make_follower_env(CONFIG, make_test_env(CONFIG, given=layouts, num_envs=2))
    rows = run_episodes(env, make_follower(CONFIG), 4)
    assert rows["success"].all()
    assert rows["control_steps"].argsort().tolist() == [0, 3, 2, 1]  # as by length
    assert env.base_env.layouts == layouts[2:]
    env.close()


def test_recorded_episodes_end_row_by_row_and_keep_what_ended_them():
    layouts = [MazeLayout((Straight(length),), start=(0.5, -0.06)) for length in (0.14, 0.09)]
    env = make_follower_env(CONFIG, make_test_env(CONFIG, given=layouts, num_envs=2))
    episodes = record_episodes(env, make_follower(CONFIG), ("pose",))
    long, short = episodes["control_steps"].squeeze(-1).tolist()
    assert short < long == episodes["trace", "pose"].shape[1]
    assert episodes["success"].all()
    ends = [episodes["trace", "pose"][row, steps - 1, 1] for row, steps in enumerate((long, short))]
    torch.testing.assert_close(torch.stack(ends), episodes["pose"][:, 1])
    env.close()


def test_the_metrics_low_pass_is_an_option():
    assert maze_metrics(replace(CONFIG, cutoff=5.0)).cutoff == 5.0


def test_the_lead_of_a_step_wise_policy_lets_it_press_on_the_floor():
    config = StepWiseMazeConfig()
    assert config.lead[2] > config.depth
