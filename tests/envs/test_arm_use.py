import os
import subprocess
import sys

import numpy as np
import pytest
import torch
from torch.testing import assert_close

from ppt_rl.envs import EngineConfig, PandaEnv, PandaPushEnv
from tests.engines import model_of
from tests.envs.scenes import act, forwarded, opengl, torques

F64 = torch.float64


# -- bad input ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"num_envs": 0}, "num_envs is 0; expected a whole number of at least 1"),
        ({"num_envs": -1}, "num_envs is -1; expected a whole number of at least 1"),
        ({"num_envs": 1.5}, "num_envs is 1.5; expected a whole number of at least 1"),
        ({"num_envs": True}, "num_envs is True; expected a whole number of at least 1"),
        (
            {"engine": EngineConfig(physics_dt=0.003)},
            r"control_dt=0.01 s is 3.33333 times physics_dt=0.003 s; expected a whole number. Set",
        ),
        ({"control_dt": -0.01}, "control_dt is -0.01; expected a finite number above 0 s"),
        ({"duration": float("nan")}, "duration is nan; expected a finite number above 0 s"),
    ],
)
def test_an_impossible_environment_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        PandaEnv(**arguments)


@pytest.mark.parametrize("shape", [(2, 6), (2, 8), (7,), (2, 1, 7)])
def test_an_action_of_the_wrong_shape_is_refused(shape):
    env = PandaEnv(2, seed=0)
    env.reset()
    with pytest.raises(ValueError, match=r"action has shape .* expected \(2, 7\).* Put JointTorqueTransform on"):
        env._checked_action(torch.zeros(shape), None)


def test_a_step_with_a_wrench_as_action_names_the_missing_transform():
    env = PandaEnv(2, seed=0)
    with pytest.raises(ValueError, match=r"action has shape \(2, 6\); expected \(2, 7\).*JointTorqueTransform"):
        act(env, env.reset(), torch.zeros(2, 6))


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_an_action_that_is_not_finite_is_refused_before_it_reaches_the_physics(value):
    env = PandaEnv(2, seed=0)
    start = env.reset()
    states = [env.engine.state(row) for row in range(2)]
    action = torch.zeros(2, 7)
    action[1, 3] = value
    with pytest.raises(
        ValueError, match=r"action \(joint torque\) holds 1 NaN or infinite entries of 14.* expected finite"
    ):
        act(env, start, action)
    assert all(np.array_equal(env.engine.state(row), states[row]) for row in range(2))


def test_the_action_of_a_masked_environment_is_ignored():
    env = PandaEnv(2, seed=0)
    action = torch.zeros(2, 7)
    action[1] = float("nan")
    after = act(env, env.reset().set("_step", torch.tensor([True, False])), action)
    assert torch.isfinite(after["pose"]).all()


@pytest.mark.parametrize("index", [-1, 2])
def test_an_environment_that_does_not_exist_has_no_physics(index):
    with pytest.raises(IndexError, match=f"environment {index} of 2; expected 0 to 1"):
        PandaEnv(2, seed=0).physics(index)


def test_an_unknown_camera_is_refused_with_the_known_ones():
    with pytest.raises(ValueError, match=r"camera is 'front'; expected one of .*overview.*side.*top"):
        PandaEnv(1, seed=0).render(camera="front")


def test_rendering_without_an_opengl_library_says_what_to_install(monkeypatch):
    monkeypatch.setattr("ppt_rl.envs.rendering.rendering_backend", lambda: "disable")
    with pytest.raises(
        RuntimeError, match=r"needs an OpenGL library, and none was found. Install EGL or OSMesa.*libegl1"
    ):
        PandaEnv(1, seed=0).render()


# -- inspection --------------------------------------------------------------------------------------------------------


@opengl
@pytest.mark.parametrize("camera", ["overview", "side", "top"])
def test_a_picture_has_the_requested_size_and_shows_something(camera):
    env = PandaPushEnv(2, seed=0)
    env.reset()
    picture = env.render(1, camera=camera, width=96, height=64)
    assert picture.shape == (64, 96, 3)
    assert picture.dtype == np.uint8
    assert picture.std() > 10
    env.close()


@opengl
def test_a_picture_shows_the_present_state():
    env = PandaPushEnv(2, seed=0)
    observation = env.reset()
    before = env.render(0, width=96, height=64)
    assert np.array_equal(before, env.render(0, width=96, height=64))
    for torque in torques(env, 10, scale=0.3).unbind(1):
        observation = act(env, observation, torque)
    assert not np.array_equal(before, env.render(0, width=96, height=64))
    env.close()


def test_the_inspected_physics_has_the_state_of_the_environment():
    env = PandaPushEnv(3, seed=0, dtype=F64)
    observation = env.reset()
    for row in (2, 0):
        data = env.physics(row).data
        assert_close(torch.from_numpy(data.qpos[:7].copy()), observation["joint_position"][row], rtol=0, atol=1e-12)
        assert_close(torch.from_numpy(data.qpos[7:].copy()), observation["box_pose"][row], rtol=0, atol=1e-12)
    observation = act(env, observation, torques(env, 1)[:, 0])
    physics = env.physics(1)
    data = forwarded(model_of(env, 1), env.engine.state(1))
    assert np.array_equal(physics.data.qpos, data.qpos)
    assert np.array_equal(physics.data.qvel, data.qvel)
    assert np.allclose(physics.named.data.site_xpos["end_effector"], data.site("end_effector").xpos, atol=1e-12)


def test_changing_the_inspected_physics_does_not_change_the_environment():
    env = PandaPushEnv(2, seed=0)
    env.reset()
    state = env.engine.state(0)
    physics = env.physics(0)
    physics.data.qpos[:] = 0.0
    physics.model.geom_friction[:] = 9.0
    assert np.array_equal(env.engine.state(0), state)
    assert model_of(env, 0).geom("box").friction[0] < 1


def test_importing_the_environments_without_a_display_prints_nothing():
    variables = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "MUJOCO_GL", "PYOPENGL_PLATFORM")}
    done = subprocess.run(
        [sys.executable, "-c", "import ppt_rl.envs"], env=variables, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
