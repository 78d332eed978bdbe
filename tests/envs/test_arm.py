import numpy as np
import pytest
import torch
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from ppt_rl.envs import EngineConfig, PandaEnv, PandaPushEnv
from tests.engines import write_state
from tests.envs.scenes import act, assert_same, leaves, rollout, torques

ENVS = [PandaEnv, PandaPushEnv]
F64 = torch.float64


# -- specs and seeds ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [torch.float32, F64])
@pytest.mark.parametrize("env_class", ENVS)
def test_observations_fit_the_specs(env_class, dtype):
    check_env_specs(env_class(2, duration=0.05, seed=0, dtype=dtype))


def test_a_tensordict_of_another_batch_size_is_refused():
    env = PandaEnv(2, seed=0)
    assert env.batch_locked
    with pytest.raises(RuntimeError, match=r"env.batch_size.* torch.Size\(\[1\]\) and torch.Size\(\[2\]\)"):
        env.step(env.reset()[:1].set("action", torch.zeros(1, 7)))


def test_a_seed_gives_bitwise_the_same_rollout_on_one_thread_and_on_two():
    runs = []
    for num_threads in (1, 2, 2):
        env = PandaPushEnv(5, duration=0.06, seed=3, engine=EngineConfig(num_threads=num_threads, name="threads"))
        runs.append(rollout(env, torques(env, 15)))
    assert_same(runs[0], runs[1])
    assert_same(runs[1], runs[2])


def test_set_seed_repeats_the_episodes():
    env = PandaPushEnv(3, seed=0)
    env.set_seed(5)
    first = env.reset()
    env.set_seed(5)
    assert_same(first, env.reset())


def test_different_seeds_draw_different_episodes_in_every_environment():
    first, second = (PandaPushEnv(4, seed=seed).reset() for seed in (0, 1))
    for key in ("box_pose", "goal", "pose"):
        assert (first[key] != second[key]).any(-1).all(), key


def test_the_environments_of_a_batch_draw_different_episodes():
    goal = PandaPushEnv(64, seed=0).reset()["goal"]
    assert len(goal.unique(dim=0)) == 64


def test_every_measured_number_varies_over_a_random_rollout():
    env = PandaEnv(3, duration=0.5, seed=0)
    observations = rollout(env, torques(env, 40))["next"]
    for key in ("joint_position", "joint_velocity", "pose", "twist", "wrench"):
        assert (observations[key].std(1) > 1e-6).all(), key


# -- memory and masks --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [torch.float32, F64])
@pytest.mark.parametrize("env_class", ENVS)
@pytest.mark.parametrize("event", ["step", "masked step", "partial reset", "full reset"])
def test_a_returned_observation_does_not_change_later(env_class, dtype, event):
    env = env_class(3, seed=0, dtype=dtype)
    torque = torques(env, 6)
    observation = env.reset()
    first = observation.clone()
    for k in range(4):
        kept = act(env, observation, torque[:, k])
        copy = kept.clone()
        observation = kept
    mask = torch.tensor([True, False, True])
    if event == "step":
        act(env, observation, torque[:, 4])
    elif event == "masked step":
        act(env, observation.copy().set("_step", mask), torque[:, 4])
    elif event == "partial reset":
        env.reset(observation.copy().set("_reset", mask.unsqueeze(-1)))
    else:
        env.reset()
    assert_same(kept, copy)
    env.set_seed(0)
    assert_same(env.reset(), first)


@pytest.mark.parametrize("env_class", ENVS)
def test_a_partial_reset_restarts_its_environments_and_leaves_the_others_alone(env_class):
    env = env_class(4, duration=0.1, seed=0)
    torque = torques(env, 8)
    observation = env.reset()
    for k in range(5):
        observation = act(env, observation, torque[:, k])
    states = [env.engine.state(row) for row in range(4)]
    mask = torch.tensor([False, True, False, True])
    after = env.reset(observation.copy().set("_reset", mask.unsqueeze(-1)))
    assert_same(after.select(*observation.keys(), strict=False), observation.select(*after.keys()), ~mask)
    for row in (0, 2):
        assert np.array_equal(env.engine.state(row), states[row])
    assert (after["joint_velocity"][mask] == 0).all()
    assert (after["joint_position"][mask] != observation["joint_position"][mask]).any(-1).all()
    for k in range(5, 8):
        act(env, after, torque[:, k])
    assert env._elapsed.squeeze(-1).tolist() == [8, 3, 8, 3]


@pytest.mark.parametrize("env_class", ENVS)
def test_environments_outside_a_step_mask_do_not_change(env_class):
    env = env_class(3, seed=0)
    torque = torques(env, 4)
    observation = act(env, env.reset(), torque[:, 0])
    states = [env.engine.state(row) for row in range(3)]
    mask = torch.tensor([True, False, True])
    after = act(env, observation.copy().set("_step", mask), torque[:, 1])
    assert np.array_equal(env.engine.state(1), states[1])
    kept = after.select("joint_position", "joint_velocity", "pose", "twist", "wrench", "diverged", "done")
    assert_same(kept, observation.select(*kept.keys()), 1)
    assert (after["joint_position"][mask] != observation["joint_position"][mask]).all()


def test_environments_outside_a_step_mask_get_no_reward():
    env = PandaPushEnv(3, seed=0)
    torque = torques(env, 3)
    observation = act(env, env.reset(), torque[:, 0])
    after = act(env, observation.copy().set("_step", torch.tensor([True, False, True])), torque[:, 1])
    assert (after["reward"] != 0).squeeze(-1).tolist() == [True, False, True]
    assert all((term[1] == 0).all() for term in after["reward_terms"].values())


def test_time_stands_still_for_environments_outside_a_step_mask():
    env = PandaEnv(3, duration=0.05, seed=0)
    observation = env.reset()
    for _ in range(2):
        observation = act(env, observation.copy().set("_step", torch.tensor([True, False, True])))
    ends = []
    for _ in range(5):
        observation = act(env, observation)
        ends.append(observation["done"].squeeze(-1).tolist())
    assert ends == [[False] * 3] * 2 + [[True, False, True]] * 2 + [[True] * 3]


def test_a_masked_step_moves_its_environments_as_a_full_step_does():
    full, masked = (PandaPushEnv(3, seed=0) for _ in range(2))
    torque = torques(full, 2)
    a = act(full, full.reset(), torque[:, 0])
    root = masked.reset().set("_step", torch.tensor([True, False, True]))
    assert_same(a, act(masked, root, torque[:, 0]), [0, 2])


# -- time --------------------------------------------------------------------------------------------------------------


def test_free_motion_is_truncated_at_its_duration_and_never_terminated():
    env = PandaEnv(2, duration=0.05, seed=0)
    ends = rollout(env, torques(env, 10))["next"]
    expected = torch.tensor([False] * 4 + [True] + [False] * 4 + [True])
    assert torch.equal(ends["truncated"][0, :, 0], expected)
    assert torch.equal(ends["done"], ends["truncated"])
    assert not ends["terminated"].any()


def test_an_episode_starts_at_the_start_pose_at_rest():
    reset = PandaEnv(2, seed=0, dtype=F64).reset()
    start = torch.tensor(PandaEnv.start_pose, dtype=F64)
    assert_close(reset["pose"][:, :3], start[:3].expand(2, 3), rtol=0, atol=1e-4)
    assert ((reset["pose"][:, 3:] * start[3:]).sum(-1).abs() > 1 - 1e-7).all()
    assert (reset["twist"] == 0).all()
    assert not reset["done"].any()


# -- divergence --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("steps_before", [0, 3])
@pytest.mark.parametrize(("entry", "value"), [(3, np.nan), (3, np.inf), (17, np.nan), (17, 1e12), (26, -1e11)])
def test_an_environment_whose_physics_diverges_is_truncated_and_affects_no_other(entry, value, steps_before):
    env, reference = (PandaPushEnv(3, seed=0) for _ in range(2))
    torque = torques(env, 6)
    observation, expected = env.reset(), reference.reset()
    for k in range(steps_before):
        observation, expected = act(env, observation, torque[:, k]), act(reference, expected, torque[:, k])
    last = observation.clone()
    write_state(env, 1, entry, value)
    observation, expected = act(env, observation, torque[:, 3]), act(reference, expected, torque[:, 3])
    for name in ("diverged", "truncated", "done"):
        assert observation[name].squeeze(-1).tolist() == [False, True, False], name
    assert not observation["terminated"].any()
    assert all(torch.isfinite(leaf).all() for leaf in leaves(observation).values())
    assert torch.equal(observation["pose"][1], last["pose"][1])
    assert_same(observation, expected, [0, 2])
    reset = env.reset(observation.copy().set("_reset", observation["done"]))
    assert not reset["done"].any()
    assert not reset["diverged"].any()
    moved = act(env, reset, torque[:, 4])
    assert not moved["diverged"].any()
    assert (moved["joint_position"][1] != reset["joint_position"][1]).all()
    assert_same(moved, act(reference, expected, torque[:, 4]), [0, 2])


def test_divergence_in_a_masked_step_marks_its_own_environment():
    env = PandaEnv(4, seed=0)
    observation = act(env, env.reset())
    write_state(env, 2, 10, np.nan)
    after = act(env, observation.set("_step", torch.tensor([True, False, True, True])))
    assert after["diverged"].squeeze(-1).tolist() == [False, False, True, False]
    assert all(torch.isfinite(leaf).all() for leaf in leaves(after).values())


def test_divergence_at_the_horizon_of_a_task_is_not_a_terminal_state():
    env = PandaPushEnv(2, duration=0.01, seed=0)
    observation = env.reset()
    write_state(env, 0, 17, np.nan)
    after = act(env, observation)
    assert after["terminated"].squeeze(-1).tolist() == [False, True]
    assert after["truncated"].squeeze(-1).tolist() == [True, False]
