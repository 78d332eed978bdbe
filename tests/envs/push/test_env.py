import math

import mujoco
import numpy as np
import pytest
import torch
from torch.testing import assert_close

from ppt_rl.envs import PandaPushEnv, PushRandomisation, PushRewards
from ppt_rl.envs.models import PADDLE
from tests.engines import SPACING, bound, model_of, models_of, write_state
from tests.envs.scenes import act, forwarded, put_box, rollout, torques

F64 = torch.float64


def in_front_of(env, row, distance, height=0.0, quat=(1.0, 0.0, 0.0, 0.0)):
    """Put the box of one environment at a distance from its goal."""
    x, y = env._episode.goal[row].tolist()
    put_box(env, row, (x - distance, y, float(env._episode.half[row]) + height), quat)


def tilted(degrees):
    """Quaternion of a rotation about the x axis."""
    return (math.cos(math.radians(degrees) / 2), math.sin(math.radians(degrees) / 2), 0.0, 0.0)


# -- success -----------------------------------------------------------------------------------------------------------


def test_success_is_a_flat_box_within_the_radius_at_the_end_of_the_episode_and_not_before():
    env = PandaPushEnv(7, duration=0.03, success_radius=0.02, seed=0)
    observation = env.reset()
    cases = [  # distance [m], height [m], tilt [degrees]
        (0.0, 0.0, 0), (0.019, 0.0, 0), (0.021, 0.0, 0), (-0.021, 0.0, 0), (0.0, 0.02, 0), (0.0, 0.001, 25),
        (0.1, 0.0, 0),
    ]  # fmt: skip
    for row, (distance, height, tilt) in enumerate(cases):
        in_front_of(env, row, distance, height, tilted(tilt))
    success = []
    for _ in range(3):
        observation = act(env, observation)
        success.append(observation["success"].squeeze(-1).tolist())
    assert success == [[False] * 7, [False] * 7, [True, True] + [False] * 5]


def test_the_success_radius_is_the_one_given():
    env = PandaPushEnv(2, duration=0.01, success_radius=0.05, seed=0)
    observation = env.reset()
    in_front_of(env, 0, 0.049)
    in_front_of(env, 1, 0.051)
    assert act(env, observation)["success"].squeeze(-1).tolist() == [True, False]


def test_a_reset_is_never_a_success():
    assert not PandaPushEnv(16, seed=0).reset()["success"].any()


# -- progress and reward -----------------------------------------------------------------------------------------------


def test_progress_is_the_share_of_the_distance_covered_and_stays_between_zero_and_one():
    env = PandaPushEnv(5, duration=0.05, seed=0, dtype=F64)
    observation = env.reset()
    assert (observation["progress"] == 0).all()
    first = (observation["box_pose"][:, :2] - observation["goal"]).norm(dim=-1)
    parts = torch.tensor([1.0, 0.75, 0.5, 0.0, -0.5], dtype=F64)
    for row, part in enumerate(parts):
        in_front_of(env, row, float((1 - part) * first[row]))
    expected = parts.clamp(0, 1).unsqueeze(-1)
    assert_close(act(env, observation)["progress"], expected, rtol=0, atol=1e-3)


def test_progress_stays_between_zero_and_one_in_random_motion():
    env = PandaPushEnv(8, duration=0.3, seed=0)
    progress = rollout(env, torques(env, 60, scale=0.3))["next", "progress"]
    assert ((progress >= 0) & (progress <= 1)).all()


def test_the_reward_is_the_sum_of_its_terms():
    env = PandaPushEnv(8, duration=0.2, seed=0)
    step = rollout(env, torques(env, 45, scale=0.3))["next"]
    terms = step["reward_terms"]
    assert set(terms.keys()) == {"progress", "free_space", "contact", "power"}
    assert_close(step["reward"], sum(terms.values()), rtol=0, atol=1e-6)
    for name in ("progress", "free_space", "power"):
        assert (terms[name] != 0).any(), name


def test_the_progress_terms_of_an_episode_add_up_to_the_distance_covered_plus_the_final_bonus():
    weights = PushRewards(progress=2.0, precision=3.0, success=5.0)
    env = PandaPushEnv(4, duration=0.04, rewards=weights, seed=0, dtype=F64)
    observation = env.reset()
    first = (observation["box_pose"][:, :2] - observation["goal"]).norm(dim=-1)
    total = torch.zeros(4, dtype=F64)
    for ends in ([0.2, 0.1, 0.05, 0.3], [0.1, 0.2, 0.0, 0.0], [0.05, 0.1, 0.1, 0.0], [0.0, 0.03, 0.01, 0.1]):
        for row, distance in enumerate(ends):
            in_front_of(env, row, distance)
        observation = act(env, observation)
        total += observation["reward_terms", "progress"].squeeze(-1)
    last = (observation["box_pose"][:, :2] - observation["goal"]).norm(dim=-1)
    done = torch.tensor([1.0, 0.0, 1.0, 0.0], dtype=F64)
    assert_close(observation["success"].squeeze(-1).to(F64), done)
    assert_close(total, 2 * (first - last) / first + 3 * torch.exp(-last / 0.02) + 5 * done, rtol=0, atol=1e-9)


def test_the_free_space_term_ends_for_good_once_the_box_has_moved():
    env = PandaPushEnv(2, seed=0)
    torque = torques(env, 8, scale=0.3)
    observation = start = env.reset()
    terms = []
    for k in range(8):
        if k == 2:
            in_front_of(env, 1, 0.1)
        if k == 5:  # back to its start
            put_box(env, 1, start["box_pose"][1, :3].tolist(), start["box_pose"][1, 3:].tolist())
        observation = act(env, observation, torque[:, k])
        terms.append(observation["reward_terms", "free_space"].squeeze(-1))
    free = torch.stack(terms) != 0
    assert free[:, 0].all()
    assert free[:2, 1].all()
    assert not free[3:, 1].any()


def test_the_contact_and_power_terms_charge_the_measured_force_and_power():
    weights = PushRewards(contact=2.0, force_limit=0.5, power=3.0)
    env = PandaPushEnv(8, duration=1.0, rewards=weights, seed=0, dtype=F64)
    step = rollout(env, torques(env, 30, scale=0.4))["next"]
    force = step["wrench"][..., :3].norm(dim=-1, keepdim=True)
    power = (step["wrench"] * step["twist"]).sum(-1, keepdim=True)
    assert (force > 0.5).any()
    assert_close(step["reward_terms", "contact"], -2.0 * (force - 0.5).clamp_min(0) * 0.01, rtol=0, atol=1e-12)
    assert_close(step["reward_terms", "power"], -3.0 * power.abs() * 0.01, rtol=0, atol=1e-12)


# -- observations ------------------------------------------------------------------------------------------------------


def test_the_observed_box_pose_is_the_simulated_one():
    env = PandaPushEnv(4, seed=0, dtype=F64)
    observation = env.reset()
    for row in range(4):
        box = forwarded(model_of(env, row), env.engine.state(row)).body("box")
        assert_close(observation["box_pose"][row], torch.from_numpy(np.concatenate([box.xpos, box.xquat])))


def test_the_observed_box_pose_follows_a_moving_box_and_its_start_does_not():
    env = PandaPushEnv(2, seed=0)
    start = env.reset()
    for row in range(2):
        write_state(env, row, 22, 0.5)  # the box's speed along x [m/s]
    observation = act(env, start)
    moved = observation["box_pose"][:, :3] - start["box_pose"][:, :3]
    assert (moved[:, 0] > 0.002).all()
    assert torch.equal(observation["box_start"], start["box_start"])
    assert torch.equal(start["box_start"], start["box_pose"][:, :2])


def test_goal_start_and_via_points_are_constant_in_an_episode_and_change_with_the_next():
    env = PandaPushEnv(3, duration=0.05, seed=0)
    run = rollout(env, torques(env, 10))["next"]
    for key in ("box_start", "goal", "via_position"):
        value = run[key].flatten(2)
        assert (value[:, :5] == value[:, :1]).all(), key
        assert (value[:, 5:] == value[:, 5:6]).all(), key
        assert (value[:, 0] != value[:, 5]).any(-1).all(), key


def test_the_via_points_are_the_tools_start_behind_the_box_and_touching_the_box_at_the_goal():
    env = PandaPushEnv(32, seed=0, dtype=F64)
    observation = env.reset()
    push = observation["goal"] - observation["box_start"]
    heading = torch.atan2(push[:, 1], push[:, 0])
    direction = torch.stack([heading.cos(), heading.sin()], -1)
    offset = 0.5 * observation["box_size"] + 0.5 * PADDLE.bar[0]
    start, behind, end = observation["via_position"].unbind(1)
    assert torch.equal(start[:, :2], observation["pose"][:, :2])
    assert (start[:, 2] == 0).all()
    assert_close(behind[:, :2], observation["box_start"] - (offset + 0.02) * direction, rtol=0, atol=1e-12)
    assert_close(end[:, :2], observation["goal"] - offset * direction, rtol=0, atol=1e-12)
    assert_close(behind[:, 2], 0.7 * heading, rtol=0, atol=1e-12)
    assert_close(end[:, 2], heading, rtol=0, atol=1e-12)
    assert observation["via_mask"].all()
    assert ((observation["via_phase"].diff(dim=-1) > 0) & (observation["via_phase"][:, 1:] <= 1)).all()
    assert (torch.linalg.eigvalsh(observation["via_cov"]) > 0).all()


def test_a_partial_reset_draws_new_tasks_for_its_environments_only():
    env = PandaPushEnv(4, seed=0)
    before = env.reset()
    mask = torch.tensor([True, False, False, True])
    after = env.reset(before.copy().set("_reset", mask.unsqueeze(-1)))
    for key in ("goal", "box_start", "box_pose", "via_position"):
        same = (after[key] == before[key]).flatten(1).all(-1)
        assert torch.equal(same, ~mask), key


# -- the start and the end of an episode -------------------------------------------------------------------------------


def test_the_tool_touches_nothing_at_the_start_of_an_episode():
    env = PandaPushEnv(128, seed=0)
    for seed in range(3):
        env.set_seed(seed)
        observation = env.reset()
        assert (observation["wrench"].abs() < 1e-6).all()
        for row, model in enumerate(models_of(env)):
            data = forwarded(model, env.engine.state(row))
            tool = {model.geom("bar").id, model.geom("stem").id}
            assert not any(tool & set(contact.geom.tolist()) for contact in data.contact), row
            gap = mujoco.mj_geomDistance(model, data, model.geom("bar").id, model.geom("box").id, 0.5, None)
            assert gap > 0.005, row


def test_a_pushing_episode_is_terminated_at_its_horizon_and_not_truncated():
    env = PandaPushEnv(2, duration=0.03, seed=0)
    ends = rollout(env, torques(env, 6))["next"]
    expected = torch.tensor([False, False, True] * 2)
    assert torch.equal(ends["terminated"][1, :, 0], expected)
    assert torch.equal(ends["done"], ends["terminated"])
    assert not ends["truncated"].any()


# -- bad input ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("box_sizes", [(0.07,), (0.06, 0.1)])
def test_a_box_size_without_a_nominal_mass_is_refused_with_the_remedy(box_sizes):
    with pytest.raises(ValueError, match=r"without a nominal mass; expected sizes among \[0.06, 0.08\] m.*box_masses"):
        PandaPushEnv(1, box_sizes=box_sizes)


@pytest.mark.parametrize("radius", [0.0, -0.01, float("nan")])
def test_a_success_radius_that_is_not_positive_is_refused(radius):
    with pytest.raises(ValueError, match=r"success_radius is .*; expected a distance above 0 m"):
        PandaPushEnv(1, success_radius=radius)


@pytest.mark.parametrize("limits", [(0.6, 0.2), (float("nan"), 0.2)])
def test_an_empty_range_is_refused(limits):
    with pytest.raises(ValueError, match=r"PushRandomisation.friction is .*; expected low <= high"):
        PushRandomisation(friction=limits)


def test_a_range_of_a_single_number_fixes_that_quantity():
    env = PandaPushEnv(3, randomisation=PushRandomisation(friction=(0.3, 0.3), goal_x=(0.65, 0.65)), seed=0)
    assert_close(env.reset()["goal"][:, 0], torch.full((3,), 0.65))
    frictions = [model.geom("box").friction[0] for model in models_of(env)]
    np.testing.assert_allclose(frictions, 0.3, rtol=bound(0.0, SPACING))
