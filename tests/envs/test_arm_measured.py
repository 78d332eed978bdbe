import pytest
import torch
from torch.testing import assert_close

from ppt_rl.arms import PANDA
from ppt_rl.envs import PandaEnv, PandaPushEnv, PushRandomisation
from ppt_rl.functional.impedance import joint_torque
from ppt_rl.functional.rotations import quat_conjugate, quat_multiply, quat_rotate
from ppt_rl.modules.kinematics import Kinematics
from ppt_rl.transforms.joint_torque import JointTorqueTransform
from tests.engines import bound, model_of
from tests.envs.scenes import MidAirEnv, act, assert_same, impedance_chain, rollout, torques

F64 = torch.float64


def moving(steps=40, num_envs=3, scale=0.1):
    """A rollout with one physics step per control step, so that finite differences in time are exact."""
    env = MidAirEnv(num_envs, control_dt=0.0005, duration=1.0, seed=0, dtype=F64)
    return env, rollout(env, torques(env, steps, scale=scale).cumsum(1) * 0.3)["next"]


def test_without_torque_the_arm_stays_where_it_is():
    env = PandaEnv(2, seed=0)
    start = env.reset()
    after = rollout(env, torch.zeros(2, 50, 7))["next"][:, -1]
    assert_close(after["joint_position"], start["joint_position"], rtol=0, atol=1e-6)


def test_the_wrench_is_zero_at_rest():
    env = MidAirEnv(2, seed=0)
    assert (rollout(env, torch.zeros(2, 10, 7))["next", "wrench"].abs() < 1e-6).all()


def test_the_force_in_free_motion_is_the_mass_of_the_tool_times_its_acceleration():
    env, run = moving()
    tool = model_of(env, 0).body("tool")
    arm = quat_rotate(run["pose"][..., 3:], env._readings._com.expand(3, 40, 3))
    speed = run["twist"][..., :3] + torch.linalg.cross(run["twist"][..., 3:], arm)
    inertial = float(tool.mass[0]) * speed.diff(dim=1) / env.engine_config.physics_dt
    assert inertial.norm(dim=-1).max() > 0.1
    assert_close(run["wrench"][:, :-1, :3], inertial, rtol=0.01, atol=1e-3)


def test_slow_free_motion_is_measured_as_less_than_a_twentieth_of_a_newton():
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


def test_the_wrench_of_a_tool_pressed_on_the_box_is_measured_as_commanded():
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


def test_the_twist_is_the_time_derivative_of_the_pose():
    env, run = moving()
    before, after = run["pose"][:, :-1], run["pose"][:, 1:]
    linear = (after[..., :3] - before[..., :3]) / env.engine_config.physics_dt
    turn = quat_multiply(after[..., 3:], quat_conjugate(before[..., 3:]))
    angular = 2 * turn[..., 1:] * turn[..., :1].sign() / env.engine_config.physics_dt
    twist = run["twist"][:, 1:]  # the integrator moves with the new velocity
    assert twist.norm(dim=-1).max() > 0.1
    rounding = bound(1e-4, 2e-3)  # in single precision of two poses, each within 5e-7 m and rad, 0.5 ms apart
    assert_close(torch.cat([linear, angular], -1), twist, rtol=1e-3, atol=rounding)


@pytest.mark.parametrize(("dtype", "atol"), [(torch.float32, 1e-5), (F64, bound(1e-9, 1e-6))])
def test_pose_and_twist_follow_from_the_joints_read_at_the_same_instant(dtype, atol):
    env = MidAirEnv(3, seed=0, dtype=dtype)
    run = rollout(env, torques(env, 30, scale=0.1))["next"]
    pose, jacobian = Kinematics(env.arm, env.tool_length, dtype=F64)(run["joint_position"].to(F64))
    sign = (pose[..., 3:] * run["pose"][..., 3:]).sum(-1, keepdim=True).sign()
    twist = (jacobian @ run["joint_velocity"].to(F64).unsqueeze(-1)).squeeze(-1)
    assert_close(run["pose"][..., :3].to(F64), pose[..., :3], rtol=0, atol=atol)
    assert_close(run["pose"][..., 3:].to(F64), pose[..., 3:] * sign, rtol=0, atol=atol)
    assert_close(run["twist"].to(F64), twist, rtol=0, atol=10 * atol)


def test_a_wrench_in_free_space_moves_the_tool_along_its_own_axis():
    env = MidAirEnv(6, seed=0, dtype=F64)
    wrench = torch.diag(torch.tensor([5.0, 5.0, 5.0, 0.5, 0.5, 0.5], dtype=F64))
    kinematics = Kinematics(env.arm, env.tool_length, dtype=F64)
    observation = env.reset()
    for _ in range(5):
        torque = joint_torque(kinematics.jacobian(observation["joint_position"]), wrench)
        observation = act(env, observation, torque)
    assert (observation["twist"].diagonal() > 0.01).all()


def test_the_wrench_transform_commands_the_torque_that_the_environment_executes(monkeypatch):
    env, received = MidAirEnv(2, seed=0, dtype=F64), []
    step = env.engine.step
    monkeypatch.setattr(env.engine, "step", lambda control, mask: received.append(control) or step(control, mask))
    kinematics = Kinematics(env.arm, env.tool_length, dtype=F64)
    transform = JointTorqueTransform(kinematics, posture_stiffness=0.0, posture_damping=0.0)
    start = env.reset()
    wrench = torch.tensor([[1.0, 2.0, 3.0, 0.1, 0.2, 0.3]], dtype=F64).expand(2, 6)
    commanded = transform.inv(start.clone().set("action", wrench))["action"]
    assert_close(commanded, joint_torque(kinematics.jacobian(start["joint_position"]), wrench))
    act(env, start, commanded)
    assert torch.equal(received[0], commanded)


def test_torque_above_the_limits_acts_like_torque_at_the_limits():
    limit = torch.tensor(PANDA.joints.torque_limits).expand(2, 7)
    runs = []
    for torque in (limit, 3 * limit, -limit, -3 * limit):
        env = MidAirEnv(2, seed=0)
        runs.append(act(env, env.reset(), torque))
    assert_same(runs[0], runs[1])
    assert_same(runs[2], runs[3])
