"""``transform.double()`` over an environment in single precision: buffers in float64, readings in float32."""

from __future__ import annotations

import pytest
import torch
from torchrl.envs.utils import check_env_specs

from tests.transforms.cases import CASES, make_chain_env, make_env
from tests.transforms.mocks import actions_for, play

_CAUSE = "JointTorqueTransform uses its posture, inertia and limits in their own precision instead of the wrench's"
joint_torque = pytest.mark.xfail(strict=True, raises=RuntimeError, reason=_CAUSE)
NAMES = [pytest.param(name, marks=joint_torque if name == "JointTorqueTransform" else ()) for name in sorted(CASES)]


def assert_close_and_of_the_same_precision(one, other):
    assert set(one.keys(True, True)) == set(other.keys(True, True))
    for key in one.keys(True, True):
        assert one[key].dtype == other[key].dtype, key
        torch.testing.assert_close(
            one[key], other[key], rtol=1e-4, atol=1e-4, msg=lambda text, key=key: f"{key}: {text}"
        )


@pytest.mark.parametrize("name", NAMES)
def test_a_transform_in_double_precision_keeps_the_specs_and_values_of_a_single_precision_environment(name):
    single, double = make_env(name, (2,)), make_env(name, (2,))
    double.transform.double()
    check_env_specs(double)
    actions = actions_for(single, 4)
    single.set_seed(7)
    double.set_seed(7)
    assert_close_and_of_the_same_precision(play(double, actions), play(single, actions))


@joint_torque
def test_the_whole_chain_in_double_precision_runs_over_a_single_precision_environment():
    single, double = make_chain_env(2), make_chain_env(2)
    double.transform.double()
    check_env_specs(double)
    actions = actions_for(single, 3)
    single.set_seed(7)
    double.set_seed(7)
    assert_close_and_of_the_same_precision(play(double, actions), play(single, actions))
