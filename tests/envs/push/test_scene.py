"""The pushing scene: what is randomised in it, and how its box slides."""

import math

import mujoco
import numpy as np
import pytest
import torch
from dm_control import mjcf

from ppt_rl.arms import PANDA
from ppt_rl.envs import PandaPushEnv, PushRandomisation
from ppt_rl.envs.models import remove_looks
from ppt_rl.envs.push.scene import push_scene
from tests.engines import SPACING, bound, model_of, models_of, on_warp
from tests.envs.scenes import forwarded

NOMINAL_MASS = {0.06: 0.050, 0.08: 0.080}


def compiled(root):
    return mjcf.Physics.from_mjcf_model(root).model.ptr


# -- randomisation -----------------------------------------------------------------------------------------------------


def test_the_properties_of_a_box_lie_in_their_ranges_and_are_written_to_its_own_model():
    env = PandaPushEnv(128, seed=0)
    observation = env.reset()
    ranges = PushRandomisation()
    frictions, factors = [], []
    for row, model in enumerate(models_of(env)):
        geom, body = model.geom("box"), model.body("box")
        edge = round(2 * float(geom.size[0]), 6)
        frictions.append(geom.friction[0])
        factors.append(body.mass[0] / NOMINAL_MASS[edge])
        assert geom.size.tolist() == [geom.size[0]] * 3
        assert float(observation["box_size"][row, 0]) == pytest.approx(edge)
        np.testing.assert_allclose(body.inertia, body.mass[0] * edge**2 / 6, rtol=bound(1e-12, 2 * SPACING))
    for drawn, (low, high) in ((frictions, ranges.friction), (factors, ranges.mass)):
        assert low <= min(drawn) < low + 0.1 * (high - low)
        assert high >= max(drawn) > high - 0.1 * (high - low)
        assert len(set(drawn)) == 128
    assert sorted(observation["box_size"].unique().tolist()) == pytest.approx([0.06, 0.08])


def test_a_randomised_model_equals_one_compiled_with_the_same_numbers():
    env = PandaPushEnv(4, seed=0)
    env.reset()
    for model in models_of(env):
        half, mass = float(model.geom("box").size[0]), float(model.body("box").mass[0])
        root = push_scene(PANDA, half_size=half, mass=mass)
        remove_looks(root)
        fresh = compiled(root)
        fresh.geom("box").friction[0] = model.geom("box").friction[0]
        mujoco.mj_setConst(fresh, mujoco.MjData(fresh))
        for name in ("geom_size", "geom_rbound", "geom_aabb", "geom_friction", "body_mass", "body_inertia"):
            found, expected = getattr(model, name), getattr(fresh, name)
            np.testing.assert_allclose(found, expected, rtol=bound(0.0, 2 * SPACING), atol=1e-12, err_msg=name)
        derived = ("body_subtreemass", "body_invweight0", "dof_invweight0")
        for name in derived if on_warp() else (*derived, "dof_M0"):  # Warp has no dof_M0
            found, expected = getattr(model, name), getattr(fresh, name)
            np.testing.assert_allclose(found, expected, rtol=bound(1e-6, 1e-5), atol=0, err_msg=name)


def test_start_and_goal_fill_their_ranges():
    observation = PandaPushEnv(128, seed=1).reset()
    ranges = PushRandomisation()
    yaw = 2 * torch.atan2(observation["box_pose"][:, 6], observation["box_pose"][:, 3])
    drawn = {
        "box_x": observation["box_pose"][:, 0],
        "box_y": observation["box_pose"][:, 1],
        "box_yaw": yaw,
        "goal_x": observation["goal"][:, 0],
        "goal_y": observation["goal"][:, 1],
        "tool_x": observation["pose"][:, 0],
        "tool_y": observation["pose"][:, 1],
    }
    for name, values in drawn.items():
        low, high = getattr(ranges, name)
        assert low - 1e-4 <= float(values.min()) < low + 0.1 * (high - low), name
        assert high + 1e-4 >= float(values.max()) > high - 0.1 * (high - low), name


def test_a_seed_reproduces_the_models_of_every_later_episode():
    def drawn(env):
        env.reset()
        names = ("geom_size", "geom_friction", "body_mass", "body_inertia", "body_pos", "dof_M0", "geom_rbound")
        return [np.concatenate([getattr(m, name).ravel() for name in names]) for m in models_of(env)]

    first, second = PandaPushEnv(6, seed=4), PandaPushEnv(6, seed=4)
    episodes = [(drawn(first), drawn(second)) for _ in range(3)]
    for a, b in episodes:
        np.testing.assert_array_equal(a, b)
    assert not np.array_equal(episodes[0][0], episodes[1][0])


def test_randomising_the_box_changes_neither_arm_nor_tool():
    env = PandaPushEnv(2, seed=0)
    arm = [*range(1, 1 + model_of(env, 0).body("tool").id)]
    before = [(m.body_mass[arm].copy(), m.body_inertia[arm].copy(), m.body_pos[arm].copy()) for m in models_of(env)]
    box = [m.body("box").mass[0] for m in models_of(env)]
    env.reset()
    for model, kept, mass in zip(models_of(env), before, box, strict=True):
        assert model.body("box").mass[0] != mass
        for now, then in zip((model.body_mass, model.body_inertia, model.body_pos), kept, strict=True):
            np.testing.assert_array_equal(now[arm], then)


# -- the box on the table ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("edge", [0.06, 0.08])
def test_a_box_on_the_table_settles_by_a_tenth_of_a_millimetre_and_then_stays_within_a_micrometre(edge):
    env = PandaPushEnv(4, box_sizes=(edge,), duration=2.0, seed=0)
    env.reset()
    start = np.array([env.engine.state(row)[8:15] for row in range(4)])
    path = []
    for _ in range(130):
        env.engine.step(torch.zeros(4, 7))
        path.append([env.engine.state(row)[8:15] for row in range(4)])
    # The episode starts with the box just touching; the soft contact carries its weight 0.108 mm deeper.
    moved = np.array(path) - start
    assert -0.11e-3 < moved[..., 2].min() < -0.1e-3
    assert np.abs(moved[..., [0, 1, 3, 4, 5, 6]]).max() < bound(1e-9, SPACING)
    assert np.abs(moved[30:] - moved[30]).max() < 1e-6


@pytest.mark.parametrize("degrees", [0, 30, 75])
@pytest.mark.parametrize("friction", [0.2, 0.6])
def test_a_sliding_box_stops_on_a_straight_line_after_the_distance_of_coulomb_friction(degrees, friction):
    model = compiled(push_scene(PANDA))
    model.geom("box").friction[0] = friction
    data = mujoco.MjData(model)
    data.qpos[:7] = PANDA.home
    data.qpos[7:10] = [0.5, 0.0, 0.03]
    mujoco.mj_forward(model, data)
    for _ in range(200):  # settle
        mujoco.mj_step(model, data)
    heading, speed = math.radians(degrees), 0.5
    data.qvel[7:9] = speed * np.array([math.cos(heading), math.sin(heading)])
    start, path = data.qpos[7:9].copy(), []
    for _ in range(2000):
        mujoco.mj_step(model, data)
        path.append(data.qpos[7:9] - start)
        if np.abs(data.qvel[7:9]).max() < 1e-3:
            break
    path = np.array(path)
    length = np.linalg.norm(path, axis=-1)
    assert len(path) < 2000
    off = np.arctan2(path[:, 1], path[:, 0]) - heading
    assert np.degrees(np.abs(off[length > 1e-3])).max() < 2
    assert length[-1] == pytest.approx(speed**2 / (2 * friction * 9.81), rel=0.05)


def test_the_inspected_model_has_the_box_of_its_environment():
    env = PandaPushEnv(2, seed=0)
    start = env.reset()
    for row in (1, 0):
        shown, stepped = env.physics(row).model.ptr, model_of(env, row)
        for name in ("size", "friction"):
            drawn, there = getattr(shown.geom("box"), name), getattr(stepped.geom("box"), name)
            np.testing.assert_allclose(drawn, there, rtol=bound(0.0, SPACING))
        np.testing.assert_allclose(shown.body("box").mass, stepped.body("box").mass, rtol=bound(0.0, SPACING))
        goal = forwarded(shown, env.engine.state(row)).body("goal").xpos
        np.testing.assert_allclose(goal[:2], start["goal"][row].numpy(), rtol=1e-6)
