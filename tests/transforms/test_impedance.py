from __future__ import annotations

import pytest
import torch
from torchrl.envs import TransformedEnv

from ppt_rl.modules import CartesianImpedanceController
from ppt_rl.transforms import ImpedanceTransform
from tests.transforms.mocks import MockArmEnv, actions_for, play


def test_the_executed_wrench_is_the_controllers_towards_the_reference():
    controller = CartesianImpedanceController((100.0, 200.0, 300.0, 10.0, 20.0, 30.0), 0.7)
    env = TransformedEnv(MockArmEnv((2,), action_shape=(6,)), ImpedanceTransform(controller))
    steps = play(env, actions_for(env, 5))
    reference = steps["action"]
    expected = controller(steps["pose"], steps["twist"], reference[..., :7], reference[..., 7:])
    torch.testing.assert_close(steps["next", "executed"], expected)


def test_the_linear_part_is_stiffness_times_position_error_plus_damping_times_velocity_error():
    controller = CartesianImpedanceController(400.0, damping=40.0)
    env = TransformedEnv(MockArmEnv((2,), action_shape=(6,)), ImpedanceTransform(controller))
    td = env.reset()
    reference = torch.cat([td["pose"], td["twist"]], -1)
    reference[:, :3] += torch.tensor((0.01, -0.02, 0.03))
    reference[:, 7:10] += torch.tensor((0.1, 0.2, -0.3))
    force = env.step(td.set("action", reference))["next", "executed"]
    torch.testing.assert_close(force[:, :3], torch.tensor((8.0, 0.0, 0.0)).expand(2, 3), rtol=0, atol=1e-3)
    torch.testing.assert_close(force[:, 3:], torch.zeros(2, 3), rtol=0, atol=1e-3)


def test_gradients_reach_learnable_gains():
    controller = CartesianImpedanceController(learnable=True)
    transform = ImpedanceTransform(controller)
    td = MockArmEnv((2,), action_shape=(6,)).reset().set("action", torch.randn(2, 13))
    transform.inv(td)["action"].square().sum().backward()
    assert {name for name, gain in transform.named_parameters() if gain.grad.abs().gt(0).all()} == {
        "controller.log_stiffness",
        "controller.log_damping_ratio",
    }


@pytest.mark.parametrize("size", [6, 7, 12, 14])
def test_a_reference_of_another_size_than_thirteen_is_refused(size):
    td = MockArmEnv((2,), action_shape=(6,)).reset().set("action", torch.zeros(2, size))
    with pytest.raises(ValueError, match=r"reference .*expected \(\*batch, 13\)"):
        ImpedanceTransform(CartesianImpedanceController()).inv(td)


@pytest.mark.parametrize("key", ["pose", "twist"])
def test_a_missing_observation_is_named(key):
    td = MockArmEnv((2,), action_shape=(6,)).reset().set("action", torch.zeros(2, 13)).exclude(key)
    with pytest.raises(KeyError, match=f"ImpedanceTransform needs .*{key}"):
        ImpedanceTransform(CartesianImpedanceController()).inv(td)


def test_an_unknown_action_key_is_refused_with_the_keys_that_there_are():
    env = TransformedEnv(MockArmEnv((2,), action_shape=(6,)))
    env.append_transform(ImpedanceTransform(CartesianImpedanceController(), action_key="wrong"))
    with pytest.raises(KeyError, match="wrong"):
        env.full_action_spec  # noqa: B018
