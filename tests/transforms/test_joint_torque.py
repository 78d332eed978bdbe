from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import TransformedEnv

from ppt_rl.arms import PANDA, UR5E
from ppt_rl.envs import PandaPushEnv
from ppt_rl.modules import Kinematics
from ppt_rl.transforms import JointTorqueTransform
from tests.transforms.cases import push_env
from tests.transforms.mocks import MockArmEnv, actions_for, play

LIMITS = torch.tensor(PANDA.joints.torque_limits)


def make_env(batch=(2,), horizons=(20,), **kwargs):
    return TransformedEnv(MockArmEnv(batch, horizons=horizons), JointTorqueTransform(Kinematics(PANDA, 0.1), **kwargs))


def test_the_power_key_is_wrench_times_twist():
    env = make_env()
    steps = play(env, actions_for(env, 6, scale=10.0))
    expected = (steps["action"] * steps["twist"]).sum(-1, keepdim=True)
    torch.testing.assert_close(steps["next", "power"], expected)
    assert not steps["power"][:, 0].any()


def test_without_posture_the_torque_is_the_transposed_jacobian_times_the_wrench():
    env = make_env(posture_stiffness=0.0, posture_damping=0.0)
    steps = play(env, actions_for(env, 6))
    jacobian = Kinematics(PANDA, 0.1).jacobian(steps["joint_position"])
    expected = torch.einsum("...ij,...i->...j", jacobian, steps["action"])
    torch.testing.assert_close(steps["next", "executed"], expected)


@pytest.mark.parametrize("posture", [{}, {"posture_stiffness": 10.0, "posture_damping": 2.0}])
def test_on_six_joints_there_is_no_nullspace_so_the_posture_is_left_out(posture):
    kinematics = Kinematics(UR5E, 0.1)
    position = torch.tensor(UR5E.home) + 0.1
    wrench = torch.tensor([[5.0, -3.0, 2.0, 0.1, 0.2, -0.3]])
    td = TensorDict({"joint_position": position.unsqueeze(0), "action": wrench}, [1])  # joint velocity is not needed
    torque = JointTorqueTransform(kinematics, **posture).inv(td)["action"]
    torch.testing.assert_close(torque, wrench @ kinematics.jacobian(position))


def test_the_limits_are_those_of_the_arm():
    td = TensorDict({"joint_position": torch.tensor([UR5E.home]), "action": torch.full((1, 6), 1e6)}, [1])
    kinematics = Kinematics(UR5E, 0.1)
    torque = JointTorqueTransform(kinematics).inv(td)["action"]
    limits = torch.tensor([UR5E.joints.torque_limits])
    assert float((torque.abs() / limits).max()) == pytest.approx(1.0)
    wanted = (td["action"].unsqueeze(-2) @ kinematics.jacobian(td["joint_position"])).squeeze(-2)
    torch.testing.assert_close(torque / torque.norm(), wanted / wanted.norm())


def test_the_posture_term_moves_the_joints_but_hardly_accelerates_the_end_effector():
    env = make_env()
    steps = play(env, torch.zeros(6, 2, 6))
    posture = steps["next", "executed"]
    jacobian, inertia = Kinematics(PANDA, 0.1).jacobian(steps["joint_position"]), env.transform.joint_inertia
    assert (posture.abs() < LIMITS).all()
    raw = 10.0 * (env.transform.posture - steps["joint_position"]) - 2.0 * steps["joint_velocity"]

    def accelerated(torque):
        return torch.einsum("...ij,...j->...i", jacobian, torque / inertia).norm(dim=-1)

    assert posture.norm(dim=-1).max() > 0.1
    assert (accelerated(posture) < 0.05 * accelerated(raw)).all()


def test_the_torque_stays_within_the_arms_limits_and_reaches_them():
    env = make_env()
    torque = play(env, actions_for(env, 6, scale=1000.0))["next", "executed"]
    assert (torque.abs() <= LIMITS).all()
    assert (torque.abs() == LIMITS).any()


def test_the_torque_rate_stays_within_its_limit_from_the_first_step_of_every_episode():
    env = make_env(horizons=(4,), max_torque_rate=300.0)
    steps = play(env, actions_for(env, 8, scale=200.0))
    torque = steps["next", "executed"]
    assert torch.equal(steps["next", "torque"], torque)
    before = torch.cat([torch.zeros(2, 1, 7), torque[:, :-1]], 1)
    before[:, 4] = 0.0  # the second episode begins
    change = (torque - before).abs()
    assert (change <= 3.0 + 1e-5).all()
    assert (change > 2.999).any()
    assert (torque.abs() <= LIMITS).all()


def test_without_a_rate_limit_there_is_no_torque_key():
    assert "torque" not in make_env().observation_spec.keys()


def test_the_simulated_arm_receives_what_the_transform_gives_and_pushes_along_the_wrench():
    env = push_env(2, JointTorqueTransform(Kinematics(PANDA, PandaPushEnv.tool.length)), duration=0.2)
    wrench = torch.tensor((-10.0, 0.0, 0.0, 0.0, 0.0, 0.0)).expand(10, 2, 6)
    steps = play(env, wrench)
    assert (steps["next", "twist"][:, -1, 0] < -0.01).all()
    assert (steps["next", "power"][:, 2:] > 0).all()


@pytest.mark.parametrize(
    ("kwargs", "match"),
    [
        ({"posture": (0.0,) * 6}, "posture has 6 numbers; expected 7"),
        ({"posture_stiffness": -1.0}, "posture_stiffness"),
        ({"posture_damping": -1.0}, "posture_damping"),
        ({"max_torque_rate": 0.0}, "max_torque_rate"),
        ({"max_torque_rate": 1000.0, "dt": -0.01}, "dt"),
    ],
)
def test_a_number_out_of_range_is_refused_by_name(kwargs, match):
    with pytest.raises(ValueError, match=match):
        JointTorqueTransform(Kinematics(PANDA, 0.1), **kwargs)


@pytest.mark.parametrize("size", [5, 7])
def test_a_wrench_of_another_size_than_six_is_refused(size):
    td = MockArmEnv((2,)).reset().set("action", torch.zeros(2, size))
    with pytest.raises(ValueError, match=r"wrench has shape .*expected \(\*batch, 6\)"):
        JointTorqueTransform(Kinematics(PANDA, 0.1)).inv(td)


@pytest.mark.parametrize("key", ["joint_position", "joint_velocity", "twist"])
def test_a_missing_observation_is_named(key):
    env = make_env()
    td = env.reset().set("action", torch.zeros(2, 6)).exclude(key)
    with pytest.raises(KeyError, match=f"JointTorqueTransform needs .*{key}"):
        env.step(td)
