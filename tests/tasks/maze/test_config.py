from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from ppt_rl.envs import MazeLayout, Straight
from ppt_rl.evaluation import record_episodes, run_episodes
from ppt_rl.tasks.maze import (
    RecedingConfig,
    StepWiseMazeConfig,
    make_follower,
    make_follower_env,
    make_maze_promp,
    make_test_env,
    make_training_env,
    maze_metrics,
)

CONFIG = RecedingConfig(num_envs=2, num_threads=1, physics_dt=0.002, seed=3)


def test_training_and_test_are_built_from_the_same_options_but_for_mazes_and_time():
    training, test = (make(CONFIG, num_envs=2, seed=3) for make in (make_training_env, make_test_env))
    training.reset()
    test.reset()
    assert training.duration == CONFIG.training_duration
    assert test.duration == CONFIG.duration
    assert [layout.is_straight for layout in (*training.layouts, *test.layouts)] == [True, True, False, False]
    assert training.engine_config.physics_dt == test.engine_config.physics_dt == CONFIG.physics_dt


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
