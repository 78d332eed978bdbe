import mujoco
import numpy as np
import pytest
import torch
from dm_control import mjcf

from ppt_rl.arms import PANDA
from ppt_rl.envs.physics import ThreadedPhysics, substeps_per_control_step
from ppt_rl.envs.push.scene import push_scene

STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
SUBSTEPS = 20


def make_engine(num_envs=4, num_threads=2):
    """An engine of pushing scenes in which every box has another mass."""
    model = mjcf.Physics.from_mjcf_model(push_scene(PANDA)).model.ptr
    engine = ThreadedPhysics(model, num_envs, SUBSTEPS, num_threads)
    for row, each in enumerate(engine.models):
        each.body("box").mass[:] = 0.05 * (1 + row)
    position = np.tile([*PANDA.home, 0.45, 0.0, 0.03, 1.0, 0.0, 0.0, 0.0], (num_envs, 1))
    # At home the tool is in the air and touches nothing; the boxes fall from different heights.
    position[:, 9] += 0.0005 * np.arange(num_envs)
    engine.reset(torch.arange(num_envs), torch.from_numpy(position))
    return engine


def controls(num_envs, steps, seed=0):
    """Random torques, ``(steps, num_envs, 7)``."""
    limits = np.asarray(PANDA.joints.torque_limits)
    return torch.from_numpy(np.random.default_rng(seed).uniform(-0.1, 0.1, (steps, num_envs, 7)) * limits)


def plain_control_step(model, state, control):
    """A control step with plain MuJoCo calls: the next state, and the sensors of every substep."""
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, state, STATE)
    data.qacc_warmstart[:] = 0.0
    data.ctrl[:] = control
    sensors = []
    for _ in range(SUBSTEPS):
        mujoco.mj_step(model, data)
        sensors.append(data.sensordata.copy())
    after = np.empty_like(state)
    mujoco.mj_getState(model, data, after, STATE)
    return after, np.asarray(sensors)


@pytest.mark.parametrize("num_threads", [1, 2])
def test_the_engine_equals_a_plain_loop_of_physics_steps(num_threads):
    engine = make_engine(num_threads=num_threads)
    states = [engine.state(row) for row in range(4)]
    for control in controls(4, 6):
        step = engine.step(control)
        for row in range(4):
            states[row], sensors = plain_control_step(engine.models[row], states[row], control[row].numpy())
            np.testing.assert_allclose(step.sensors[row], sensors, rtol=0, atol=1e-12)
            np.testing.assert_allclose(engine.state(row), states[row], rtol=0, atol=1e-12)
    assert not step.diverged.any()


def test_a_step_of_some_environments_equals_their_part_of_a_full_step():
    full, some = make_engine(), make_engine()
    (control,) = controls(4, 1)
    before = some.state(1)
    expected = full.step(control).sensors.clone()
    mask = torch.tensor([True, False, True, True])
    assert torch.equal(some.step(control, mask).sensors[mask], expected[mask])
    for row in (0, 2, 3):
        np.testing.assert_array_equal(some.state(row), full.state(row))
    np.testing.assert_array_equal(some.state(1), before)


def test_a_reset_returns_the_sensor_readings_of_the_new_state():
    engine = make_engine()
    engine.step(controls(4, 1)[0])
    position = np.array([[*PANDA.home, 0.5, 0.1, 0.03, 1.0, 0.0, 0.0, 0.0]])
    sensors = engine.reset(torch.tensor([2]), torch.from_numpy(position))
    data = mujoco.MjData(engine.models[2])
    mujoco.mj_setState(engine.models[2], data, engine.state(2), STATE)
    mujoco.mj_forward(engine.models[2], data)
    np.testing.assert_array_equal(data.qpos, position[0])
    assert not data.qvel.any()
    np.testing.assert_allclose(sensors[0], data.sensordata, rtol=0, atol=1e-12)


@pytest.mark.parametrize("warm", [0, 2])
@pytest.mark.parametrize("value", [np.nan, np.inf, 1e12])
def test_a_diverging_environment_is_flagged_and_keeps_its_state(warm, value):
    engine = make_engine()
    for control in controls(4, warm):
        engine.step(control)
    engine._state[2, 17] = value
    before = engine.state(2)
    step = engine.step(torch.zeros(4, 7))
    assert step.diverged.tolist() == [False, False, True, False]
    np.testing.assert_array_equal(engine.state(2), before)


def test_a_diverging_environment_does_not_affect_the_others():
    engine, reference = make_engine(num_threads=1), make_engine(num_threads=1)
    engine._state[0, 17] = np.nan
    for control in controls(4, 3):
        a, b = engine.step(control), reference.step(control)
        np.testing.assert_array_equal(a.sensors[1:], b.sensors[1:])
        assert a.diverged.tolist() == [True, False, False, False]


def test_the_returned_state_is_a_copy():
    engine = make_engine()
    engine.state(0)[:] = 0.0
    assert engine.state(0)[1:8].any()


@pytest.mark.parametrize(("control_dt", "physics_dt", "substeps"), [(0.01, 0.0005, 20), (0.01, 0.01, 1), (0.3, 0.1, 3)])
def test_the_number_of_substeps_is_the_ratio_of_the_time_steps(control_dt, physics_dt, substeps):
    assert substeps_per_control_step(control_dt, physics_dt) == substeps


@pytest.mark.parametrize(("control_dt", "physics_dt"), [(0.01, 0.003), (0.01, 0.02), (0.0101, 0.0005)])
def test_a_time_step_that_does_not_divide_the_control_step_is_refused_with_one_that_does(control_dt, physics_dt):
    with pytest.raises(ValueError, match=r"expected a whole number\. Set, for instance, physics_dt=") as error:
        substeps_per_control_step(control_dt, physics_dt)
    proposed = float(str(error.value).rsplit("=", 1)[1].rstrip("."))
    assert substeps_per_control_step(control_dt, proposed) >= 1


@pytest.mark.parametrize(("control_dt", "physics_dt"), [(0.01, 0.0), (0.01, -0.0005), (-0.01, 0.0005), (0.0, 0.0005)])
def test_a_time_step_that_is_not_positive_is_refused(control_dt, physics_dt):
    with pytest.raises(ValueError, match="expected both above 0"):
        substeps_per_control_step(control_dt, physics_dt)
