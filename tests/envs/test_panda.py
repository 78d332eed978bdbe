import ctypes.util
import os
import subprocess
import sys

import numpy as np
import pytest
import torch
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from ppt_rl.envs import PandaEnv, PandaPushEnv, PushRandomisation
from ppt_rl.functional.impedance import joint_torque
from ppt_rl.functional.rotations import quat_conjugate, quat_multiply, quat_rotate
from ppt_rl.modules.kinematics import PandaKinematics
from ppt_rl.modules.panda import TORQUE_LIMITS
from ppt_rl.transforms.joint_torque import JointTorqueTransform
from tests.envs.scenes import MidAirEnv, act, forwarded, impedance_chain, leaves, rollout, torques

ENVS = [PandaEnv, PandaPushEnv]
F64 = torch.float64
opengl = pytest.mark.skipif(
    not (ctypes.util.find_library("EGL") or ctypes.util.find_library("OSMesa")),
    reason="no OpenGL library for off-screen rendering: neither EGL nor OSMesa",
)


def assert_same(a, b, rows=slice(None)):
    """Every tensor of two tensordicts is bitwise the same in some rows."""
    a, b = leaves(a), leaves(b)
    assert a.keys() == b.keys()
    for name in a:
        assert torch.equal(a[name][rows], b[name][rows]), name


# -- specs and seeds ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [torch.float32, F64])
@pytest.mark.parametrize("env_class", ENVS)
def test_what_comes_back_fits_the_specs(env_class, dtype):
    check_env_specs(env_class(2, duration=0.05, seed=0, dtype=dtype))


def test_a_tensordict_of_another_batch_size_is_refused():
    env = PandaEnv(2, seed=0)
    assert env.batch_locked
    with pytest.raises(RuntimeError, match=r"env.batch_size.* torch.Size\(\[1\]\) and torch.Size\(\[2\]\)"):
        env.step(env.reset()[:1].set("action", torch.zeros(1, 7)))


def test_a_seed_gives_the_same_rollout_to_the_bit_on_one_thread_and_on_two():
    runs = []
    for num_threads in (1, 2, 2):
        env = PandaPushEnv(5, duration=0.06, seed=3, num_threads=num_threads)
        runs.append(rollout(env, torques(env, 15)))
    assert_same(runs[0], runs[1])
    assert_same(runs[1], runs[2])


def test_set_seed_repeats_the_episodes():
    env = PandaPushEnv(3, seed=0)
    env.set_seed(5)
    first = env.reset()
    env.set_seed(5)
    assert_same(first, env.reset())


def test_two_seeds_draw_two_episodes_in_every_row():
    first, second = (PandaPushEnv(4, seed=seed).reset() for seed in (0, 1))
    for key in ("box_pose", "goal", "pose"):
        assert (first[key] != second[key]).any(-1).all(), key


def test_the_rows_of_a_batch_draw_different_episodes():
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
def test_a_kept_observation_does_not_change_afterwards(env_class, dtype, event):
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
def test_a_partial_reset_restarts_its_rows_and_leaves_the_others_alone(env_class):
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
def test_rows_outside_a_step_mask_stay_as_they_are(env_class):
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


def test_rows_outside_a_step_mask_earn_nothing():
    env = PandaPushEnv(3, seed=0)
    torque = torques(env, 3)
    observation = act(env, env.reset(), torque[:, 0])
    after = act(env, observation.copy().set("_step", torch.tensor([True, False, True])), torque[:, 1])
    assert (after["reward"] != 0).squeeze(-1).tolist() == [True, False, True]
    assert all((term[1] == 0).all() for term in after["reward_terms"].values())


def test_rows_outside_a_step_mask_do_not_count_time():
    env = PandaEnv(3, duration=0.05, seed=0)
    observation = env.reset()
    for _ in range(2):
        observation = act(env, observation.copy().set("_step", torch.tensor([True, False, True])))
    ends = []
    for _ in range(5):
        observation = act(env, observation)
        ends.append(observation["done"].squeeze(-1).tolist())
    assert ends == [[False] * 3] * 2 + [[True, False, True]] * 2 + [[True] * 3]


def test_a_masked_step_moves_its_rows_as_a_full_step_does():
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
def test_a_row_whose_physics_blows_up_is_truncated_and_touches_no_other(entry, value, steps_before):
    env, reference = (PandaPushEnv(3, seed=0) for _ in range(2))
    torque = torques(env, 6)
    observation, expected = env.reset(), reference.reset()
    for k in range(steps_before):
        observation, expected = act(env, observation, torque[:, k]), act(reference, expected, torque[:, k])
    last = observation.clone()
    env.engine._state[1, entry] = value
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


def test_divergence_in_a_masked_step_marks_its_own_row():
    env = PandaEnv(4, seed=0)
    observation = act(env, env.reset())
    env.engine._state[2, 10] = np.nan
    after = act(env, observation.set("_step", torch.tensor([True, False, True, True])))
    assert after["diverged"].squeeze(-1).tolist() == [False, False, True, False]
    assert all(torch.isfinite(leaf).all() for leaf in leaves(after).values())


def test_divergence_at_the_horizon_of_a_task_is_no_terminal_state():
    env = PandaPushEnv(2, duration=0.01, seed=0)
    observation = env.reset()
    env.engine._state[0, 17] = np.nan
    after = act(env, observation)
    assert after["terminated"].squeeze(-1).tolist() == [False, True]
    assert after["truncated"].squeeze(-1).tolist() == [True, False]


# -- what is measured --------------------------------------------------------------------------------------------------


def moving(steps=40, num_envs=3, scale=0.1):
    """Rollout at physics rate: one physics step per control step, so that differences in time are exact."""
    env = MidAirEnv(num_envs, control_dt=0.0005, duration=1.0, seed=0, dtype=F64)
    return env, rollout(env, torques(env, steps, scale=scale).cumsum(1) * 0.3)["next"]


def test_no_torque_leaves_the_arm_where_it_is():
    env = PandaEnv(2, seed=0)
    start = env.reset()
    after = rollout(env, torch.zeros(2, 50, 7))["next"][:, -1]
    assert_close(after["joint_position"], start["joint_position"], rtol=0, atol=1e-6)


def test_the_wrench_is_zero_at_rest():
    env = MidAirEnv(2, seed=0)
    assert (rollout(env, torch.zeros(2, 10, 7))["next", "wrench"].abs() < 1e-6).all()


def test_the_force_in_free_motion_is_the_mass_of_the_tool_times_its_acceleration():
    env, run = moving()
    tool = env.engine.models[0].body("tool")
    arm = quat_rotate(run["pose"][..., 3:], env._readings._com.expand(3, 40, 3))
    speed = run["twist"][..., :3] + torch.linalg.cross(run["twist"][..., 3:], arm)
    inertial = float(tool.mass[0]) * speed.diff(dim=1) / env.physics_dt
    assert inertial.norm(dim=-1).max() > 0.1
    assert_close(run["wrench"][:, :-1, :3], inertial, rtol=0.01, atol=1e-3)


def test_slow_free_motion_is_felt_as_less_than_a_twentieth_of_a_newton():
    env = impedance_chain(MidAirEnv(2, duration=1.0, seed=0))
    observation, worst = env.reset(), 0.0
    for k in range(100):
        reference = torch.zeros(2, 13)
        reference[:, :7] = torch.tensor(MidAirEnv.start_pose)
        reference[:, 0] += 0.05 * 0.01 * k * min(1.0, k / 50)
        reference[:, 7] = 0.05 * min(1.0, k / 25)
        observation = act(env, observation, reference)
        worst = max(worst, float(observation["wrench"][:, :3].norm(dim=-1).max()))
    assert observation["pose"][0, 0] > MidAirEnv.start_pose[0] + 0.03
    assert worst < 0.05


def test_a_tool_pressed_down_is_measured_with_the_wrench_it_is_pressed_with():
    class AboveBox(PandaPushEnv):
        start_pose = (0.45, 0.0, 0.066, 0.0, 1.0, 0.0, 0.0)

    ranges = {"box_x": (0.45, 0.45), "box_y": (0.0, 0.0), "tool_x": (0.45, 0.45), "tool_y": (0.0, 0.0)}
    ranges |= {"box_yaw": (0.0, 0.0)}
    push = AboveBox(3, box_sizes=(0.06,), randomisation=PushRandomisation(**ranges), duration=4.0, seed=0)
    env = impedance_chain(push, posture_stiffness=0.0)  # nothing but the wrench acts
    depth = torch.tensor([0.01, 0.02, 0.04])  # of the reference below the top of the box [m]
    reference = torch.zeros(3, 13)
    reference[:, :7] = torch.tensor(AboveBox.start_pose)
    reference[:, 2] = 0.065 - depth
    observation = env.reset()
    for _ in range(300):
        observation = act(env, observation, reference)
    controller = env.transform[-1].controller
    commanded = controller(observation["pose"], observation["twist"], reference[:, :7], reference[:, 7:])
    assert (commanded[:, 2] < -300 * depth).all()
    assert_close(observation["wrench"][:, :3], commanded[:, :3], rtol=0, atol=0.005)
    assert_close(observation["wrench"][:, 3:], commanded[:, 3:], rtol=0, atol=0.001)


def test_the_twist_is_the_rate_of_the_pose():
    env, run = moving()
    before, after = run["pose"][:, :-1], run["pose"][:, 1:]
    linear = (after[..., :3] - before[..., :3]) / env.physics_dt
    turn = quat_multiply(after[..., 3:], quat_conjugate(before[..., 3:]))
    angular = 2 * turn[..., 1:] * turn[..., :1].sign() / env.physics_dt
    twist = run["twist"][:, 1:]  # the integrator moves with the new velocity
    assert twist.norm(dim=-1).max() > 0.1
    assert_close(torch.cat([linear, angular], -1), twist, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize(("dtype", "atol"), [(torch.float32, 1e-5), (F64, 1e-9)])
def test_pose_and_twist_follow_from_the_joints_read_at_the_same_instant(dtype, atol):
    env = MidAirEnv(3, seed=0, dtype=dtype)
    run = rollout(env, torques(env, 30, scale=0.1))["next"]
    pose, jacobian = PandaKinematics(env.tool_length, dtype=F64)(run["joint_position"].to(F64))
    sign = (pose[..., 3:] * run["pose"][..., 3:]).sum(-1, keepdim=True).sign()
    twist = (jacobian @ run["joint_velocity"].to(F64).unsqueeze(-1)).squeeze(-1)
    assert_close(run["pose"][..., :3].to(F64), pose[..., :3], rtol=0, atol=atol)
    assert_close(run["pose"][..., 3:].to(F64), pose[..., 3:] * sign, rtol=0, atol=atol)
    assert_close(run["twist"].to(F64), twist, rtol=0, atol=10 * atol)


def test_a_wrench_in_free_space_moves_the_tool_along_its_own_axis():
    env = MidAirEnv(6, seed=0, dtype=F64)
    wrench = torch.diag(torch.tensor([5.0, 5.0, 5.0, 0.5, 0.5, 0.5], dtype=F64))
    kinematics = PandaKinematics(env.tool_length, dtype=F64)
    observation = env.reset()
    for _ in range(5):
        torque = joint_torque(kinematics.jacobian(observation["joint_position"]), wrench)
        observation = act(env, observation, torque)
    assert (observation["twist"].diagonal() > 0.01).all()


def test_the_wrench_transform_commands_the_torque_that_the_environment_executes():
    env = MidAirEnv(2, seed=0, dtype=F64)
    kinematics = PandaKinematics(env.tool_length, dtype=F64)
    transform = JointTorqueTransform(kinematics, posture_stiffness=0.0, posture_damping=0.0)
    start = env.reset()
    wrench = torch.tensor([[1.0, 2.0, 3.0, 0.1, 0.2, 0.3]], dtype=F64).expand(2, 6)
    commanded = transform.inv(start.clone().set("action", wrench))["action"]
    assert_close(commanded, joint_torque(kinematics.jacobian(start["joint_position"]), wrench))
    act(env, start, commanded)
    assert np.array_equal(env.engine._control[:, 0], commanded.numpy())


def test_torque_above_the_limits_acts_as_torque_at_the_limits():
    limit = torch.tensor(TORQUE_LIMITS).expand(2, 7)
    runs = []
    for torque in (limit, 3 * limit, -limit, -3 * limit):
        env = MidAirEnv(2, seed=0)
        runs.append(act(env, env.reset(), torque))
    assert_same(runs[0], runs[1])
    assert_same(runs[2], runs[3])


# -- bad input ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"num_envs": 0}, "num_envs is 0; expected a whole number of at least 1"),
        ({"num_envs": -1}, "num_envs is -1; expected a whole number of at least 1"),
        ({"num_envs": 1.5}, "num_envs is 1.5; expected a whole number of at least 1"),
        ({"num_envs": True}, "num_envs is True; expected a whole number of at least 1"),
        ({"num_threads": 0}, "num_threads is 0; expected at least 1, or None"),
        (
            {"physics_dt": 0.003},
            r"control_dt=0.01 s is 3.33333 times physics_dt=0.003 s; expected a whole number. Take",
        ),
        ({"physics_dt": 0.0}, "physics_dt is 0.0; expected a finite number above 0 s"),
        ({"control_dt": -0.01}, "control_dt is -0.01; expected a finite number above 0 s"),
        ({"duration": float("nan")}, "duration is nan; expected a finite number above 0 s"),
    ],
)
def test_an_impossible_environment_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        PandaEnv(**arguments)


@pytest.mark.parametrize("shape", [(2, 6), (2, 8), (7,), (2, 1, 7)])
def test_an_action_of_another_shape_is_refused(shape):
    env = PandaEnv(2, seed=0)
    env.reset()
    with pytest.raises(ValueError, match=r"action has shape .* expected \(2, 7\).* Put JointTorqueTransform on"):
        env._checked_torque(torch.zeros(shape), None)


def test_a_step_with_a_wrench_for_an_action_says_which_transform_is_missing():
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


def test_what_a_masked_row_would_do_is_not_looked_at():
    env = PandaEnv(2, seed=0)
    action = torch.zeros(2, 7)
    action[1] = float("nan")
    after = act(env, env.reset().set("_step", torch.tensor([True, False])), action)
    assert torch.isfinite(after["pose"]).all()


@pytest.mark.parametrize("index", [-1, 2])
def test_an_environment_that_does_not_exist_has_no_physics(index):
    with pytest.raises(IndexError, match=f"environment {index} of 2; expected 0 to 1"):
        PandaEnv(2, seed=0).physics(index)


def test_a_camera_that_does_not_exist_is_refused_with_those_that_do():
    with pytest.raises(ValueError, match=r"camera is 'front'; expected one of .*overview.*side.*top"):
        PandaEnv(1, seed=0).render(camera="front")


def test_without_an_opengl_library_rendering_says_what_to_install(monkeypatch):
    monkeypatch.setattr("ppt_rl.envs.rendering.rendering_backend", lambda: "disable")
    with pytest.raises(
        RuntimeError, match=r"needs an OpenGL library and none was found; install EGL or OSMesa.*libegl1"
    ):
        PandaEnv(1, seed=0).render()


# -- inspection --------------------------------------------------------------------------------------------------------


@opengl
@pytest.mark.parametrize("camera", ["overview", "side", "top"])
def test_a_picture_has_the_size_asked_for_and_shows_something(camera):
    env = PandaPushEnv(2, seed=0)
    env.reset()
    picture = env.render(1, camera=camera, width=96, height=64)
    assert picture.shape == (64, 96, 3)
    assert picture.dtype == np.uint8
    assert picture.std() > 10
    env.close()


@opengl
def test_a_picture_follows_the_environment():
    env = PandaPushEnv(2, seed=0)
    observation = env.reset()
    before = env.render(0, width=96, height=64)
    assert np.array_equal(before, env.render(0, width=96, height=64))
    for torque in torques(env, 10, scale=0.3).unbind(1):
        observation = act(env, observation, torque)
    assert not np.array_equal(before, env.render(0, width=96, height=64))
    env.close()


def test_the_inspected_physics_is_in_the_state_of_the_environment():
    env = PandaPushEnv(3, seed=0, dtype=F64)
    observation = env.reset()
    for row in (2, 0):
        data = env.physics(row).data
        assert_close(torch.from_numpy(data.qpos[:7].copy()), observation["joint_position"][row], rtol=0, atol=1e-12)
        assert_close(torch.from_numpy(data.qpos[7:].copy()), observation["box_pose"][row], rtol=0, atol=1e-12)
    observation = act(env, observation, torques(env, 1)[:, 0])
    physics = env.physics(1)
    data = forwarded(env.engine.models[1], env.engine.state(1))
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
    assert env.engine.models[0].geom("box").friction[0] < 1


def test_importing_the_environments_without_a_display_says_nothing():
    variables = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "MUJOCO_GL", "PYOPENGL_PLATFORM")}
    done = subprocess.run(
        [sys.executable, "-c", "import ppt_rl.envs"], env=variables, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
