from __future__ import annotations

import math

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import Compose, TransformedEnv
from torchrl.envs.utils import check_env_specs

from ppt_rl.envs import PandaEnv
from ppt_rl.modules import JointSpace, ProMP
from ppt_rl.transforms import CartesianVelocityTransform, MacroStepTransform, PDTrackingTransform, ProMPTransform
from tests.engines import COARSE
from tests.transforms.mocks import MockArmEnv, actions_for, play

#: Gains that hold the joints of a Panda stiffly.
STIFF = (600.0, 600.0, 600.0, 600.0, 250.0, 150.0, 50.0)
DAMPING = (50.0, 50.0, 50.0, 50.0, 30.0, 25.0, 15.0)


def inverse(transform, position, velocity, reference, **more):
    td = TensorDict({"joint_position": position, "joint_velocity": velocity, "action": reference, **more}, [])
    return transform.inv(td)["action"]


def test_the_effort_is_that_of_a_spring_and_a_damper_in_each_joint():
    q, dq, reference = torch.randn(5, 3), torch.randn(5, 3), torch.randn(5, 6)
    stiffness, damping = torch.tensor([1.0, 2.0, 3.0]), 0.5
    effort = inverse(PDTrackingTransform(stiffness.tolist(), damping), q, dq, reference)
    torch.testing.assert_close(effort, stiffness * (reference[:, :3] - q) + damping * (reference[:, 3:] - dq))


def test_a_continuous_joint_is_pulled_the_shorter_way_round():
    transform = PDTrackingTransform(1.0, 0.0, continuous=(0,))
    effort = inverse(transform, torch.tensor([3.0, 3.0]), torch.zeros(2), torch.tensor([-3.0, -3.0, 0.0, 0.0]))
    torch.testing.assert_close(effort, torch.tensor([2 * math.pi - 6.0, -6.0]))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_effort_has_the_precision_of_the_action_whatever_that_of_the_readings(dtype):
    effort = inverse(
        PDTrackingTransform(1.0, 1.0), torch.ones(2).double(), torch.ones(2).double(), torch.ones(4, dtype=dtype)
    )
    assert effort.dtype is dtype


def test_a_primitive_over_joints_makes_chunks_of_positions_and_velocities():
    base = MockArmEnv((2,), action_shape=(5, 14), horizons=(20,))
    promp = ProMP(4, 7, duration=0.1)
    env = TransformedEnv(base, ProMPTransform(promp, JointSpace(7), replan_steps=5, pose_key="joint_position"))
    check_env_specs(env)
    root = env.reset()
    start = root["joint_position"].clone()
    step = env.step(root.set("action", 3 * actions_for(env, 1)[0]))["next"]
    chunk, left = step["executed"], step["reference_position"]
    torch.testing.assert_close(chunk[:, 0, :7], start, rtol=0, atol=1e-5)  # it begins where the joints are, at rest
    torch.testing.assert_close(chunk[:, 0, 7:], torch.zeros(2, 7), rtol=0, atol=1e-4)
    later = torch.cat([chunk[:, 1:, :7], left.unsqueeze(1)], 1)
    slope = (later - chunk[..., :7]) / 0.01
    assert (slope - chunk[..., 7:]).abs().max() < 0.5 * slope.abs().max()  # forward differences, up to acceleration


def test_a_panda_follows_a_primitive_of_its_joints_without_any_kinematics():
    base = PandaEnv(2, duration=1.0, seed=0, engine=COARSE)
    promp = ProMP(6, 7, duration=1.0)
    promp.weights_mean.copy_(torch.tensor(base.arm.home).expand(6, 7))
    chain = (
        PDTrackingTransform(STIFF, DAMPING),
        MacroStepTransform(100, trace_keys=["joint_position"]),
        ProMPTransform(promp, JointSpace(7), residual_scale=0.2, pose_key="joint_position"),
    )
    env = TransformedEnv(base, Compose(*chain))
    check_env_specs(env)
    step = env.step(env.reset().set("action", 0.3 * actions_for(env, 1)[0]))["next"]
    moved = step["trace", "joint_position"]
    assert (moved[:, -1] - moved[:, 0]).abs().max() > 0.1
    assert (moved[:, -1] - step["reference_position"]).abs().max() < 0.02
    env.close()


def test_joint_velocities_of_a_step_wise_policy_are_integrated_to_references():
    base = MockArmEnv((2,), horizons=(20,))
    velocity = CartesianVelocityTransform(
        JointSpace(7, continuous=(6,)), max_velocity=0.5, max_lead=0.2, pose_key="joint_position"
    )
    env = TransformedEnv(base, Compose(PDTrackingTransform(10.0, 1.0), velocity))
    check_env_specs(env)
    assert env.full_action_spec["action"].shape == (2, 7)
    steps = play(env, actions_for(env, 5))["next"]
    lead = steps["reference_position"][:, 1:] - steps["joint_position"][:, :-1]
    assert lead.abs().max() <= 0.2 + 1e-5


# -- errors ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("gain", [-1.0, float("nan"), float("inf"), [], [1.0, -1.0]], ids=str)
@pytest.mark.parametrize("name", ["stiffness", "damping"])
def test_an_impossible_gain_is_refused(name, gain):
    with pytest.raises(ValueError, match=rf"{name} is .*; expected one number, or one for each joint"):
        PDTrackingTransform(**{"stiffness": 1.0, "damping": 1.0, name: gain})


def test_gains_for_another_number_of_joints_are_refused_before_the_first_step():
    env = TransformedEnv(MockArmEnv((2,)), PDTrackingTransform([1.0, 2.0], 1.0))
    with pytest.raises(ValueError, match="stiffness has 2 numbers; expected 1 or 7, one for each joint"):
        _ = env.action_spec


def test_a_reference_of_another_size_is_refused():
    with pytest.raises(ValueError, match=r"reference \(joint position and velocity\) has shape \(13,\)"):
        inverse(PDTrackingTransform(1.0, 1.0), torch.zeros(7), torch.zeros(7), torch.zeros(13))


def test_a_continuous_joint_that_there_is_not_is_refused():
    with pytest.raises(ValueError, match=r"continuous is \(2,\); expected indices of joints, 0 to 1"):
        inverse(PDTrackingTransform(1.0, 1.0, continuous=(2,)), torch.zeros(2), torch.zeros(2), torch.zeros(4))
