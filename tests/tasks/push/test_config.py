from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from ppt_rl.envs import PushRandomisation
from ppt_rl.tasks import episode_metrics, make_controller
from ppt_rl.tasks.push import PUSH, PushConfig, make_push_env
from ppt_rl.training import as_json, from_json, prepare_torch, with_settings
from tests.envs.scenes import leaves

CONFIG = PushConfig(num_envs=3, num_threads=1, duration=0.2, physics_dt=0.002, control_dt=0.02, seed=5)


@pytest.mark.parametrize(
    ("duration", "control_dt", "steps"), [(3.0, 0.01, 300), (0.3, 0.1, 3), (0.29, 0.1, 3), (1e-3, 0.01, 1)]
)
def test_the_horizon_is_the_duration_in_control_steps_and_at_least_one(duration, control_dt, steps):
    assert PushConfig(duration=duration, control_dt=control_dt).horizon == steps


def test_the_environment_is_that_of_the_options():
    env = make_push_env(replace(CONFIG, box_sizes=(0.08,), engine="threads"), num_envs=3)
    assert (env.num_envs, env.horizon, env.substeps, env.control_dt) == (3, CONFIG.horizon, 10, 0.02)
    assert (env.reset()["box_size"] == 0.08).all()
    assert env.engine.num_threads == 1
    assert "audit" not in env.observation_spec.keys()


def test_a_seed_repeats_the_episodes_and_an_audit_measures_them():
    first, again, other = (leaves(make_push_env(CONFIG, num_envs=3, seed=seed).reset()) for seed in (5, 5, 0))
    assert all(torch.equal(first[name], again[name]) for name in first)
    assert not torch.equal(first["goal"], other["goal"])
    env = make_push_env(CONFIG, num_envs=2, audit=True)
    assert env.num_envs == 2
    assert env.reset()["audit", "commanded_work"].shape == (2, 1)


def test_given_episodes_are_refused():
    with pytest.raises(ValueError, match="2 episodes are given; expected none"):
        make_push_env(CONFIG, num_envs=1, given=[1, 2])


def test_the_arm_of_the_options_is_that_of_environment_and_controller():
    config = replace(CONFIG, arm="ur5e")
    assert make_push_env(config, num_envs=1).arm.name == "ur5e"
    assert not torch.equal(make_controller(config).damping, make_controller(CONFIG).damping)


def test_controller_and_metrics_take_their_constants_from_the_options():
    config = replace(CONFIG, stiffness=123.0, damping_ratio=0.7, p_max=1.5)
    controller = make_controller(config)
    assert controller.stiffness[:3].tolist() == [123.0] * 3
    undamped = make_controller(replace(config, damping_ratio=1.4))
    torch.testing.assert_close(undamped.damping, 2 * controller.damping)
    assert episode_metrics(config).p_max == 1.5


def test_seeding_repeats_the_numbers_and_sets_the_threads():
    before = torch.get_num_threads()
    try:
        draws = []
        for seed in (1, 1, 2):
            prepare_torch(replace(CONFIG, seed=seed, torch_threads=2))
            draws.append(torch.rand(3).tolist())
            assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)
    assert draws[0] == draws[1] != draws[2]


def test_a_harder_task_is_one_option_and_survives_its_json_form():
    harder = {"randomisation.com": "-0.015,0.015", "randomisation.error": "0.01,0.01", "box_masses": "0.7,0.7"}
    config = with_settings(CONFIG, harder)
    assert from_json(PushConfig, as_json(config)) == config
    env = make_push_env(config, num_envs=2, seed=0)
    assert env.randomisation == PushRandomisation(com=(-0.015, 0.015), error=(0.01, 0.01))
    reading = env.reset()
    torch.testing.assert_close(reading["box_start"], reading["box_pose"][:, :2] + 0.01, atol=1e-4, rtol=0)
    env.close()


def test_a_range_that_is_none_is_refused_on_the_command_line():
    with pytest.raises(ValueError, match=r"PushRandomisation\.com"):
        with_settings(CONFIG, {"randomisation.com": "0.01"})


def test_masses_reach_the_environment_and_each_group_keeps_its_own():
    config = replace(CONFIG, box_sizes=(0.06, 0.1), box_masses=(0.05, 0.2))
    env = make_push_env(config, num_envs=2)
    assert (env.boxes.sizes, env.boxes.masses) == ((0.06, 0.1), (0.05, 0.2))
    env.close()
    groups = PUSH.groups(config)
    assert groups["10 cm"] == {"box_sizes": (0.1,), "box_masses": (0.2,)}
    assert PUSH.groups(CONFIG)["6 cm"] == {"box_sizes": (0.06,)}
