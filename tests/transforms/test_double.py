"""``transform.double()`` over an environment in single precision: buffers in float64, readings in float32."""

from __future__ import annotations

import pytest
import torch
from torchrl.envs.utils import check_env_specs

from tests.transforms.cases import CASES, make_chain_env, make_env
from tests.transforms.mocks import actions_for, play


def assert_close_and_of_the_same_precision(one, other):
    assert set(one.keys(True, True)) == set(other.keys(True, True))
    for key in one.keys(True, True):
        assert one[key].dtype == other[key].dtype, key
        torch.testing.assert_close(
            one[key], other[key], rtol=1e-4, atol=1e-4, msg=lambda text, key=key: f"{key}: {text}"
        )


@pytest.mark.parametrize("name", sorted(CASES))
def test_a_transform_in_double_precision_keeps_the_specs_and_values_of_a_single_precision_environment(name):
    single, double = make_env(name, (2,)), make_env(name, (2,))
    double.transform.double()
    check_env_specs(double)
    actions = actions_for(single, 4)
    single.set_seed(7)
    double.set_seed(7)
    assert_close_and_of_the_same_precision(play(double, actions), play(single, actions))


def test_the_whole_chain_in_double_precision_runs_over_a_single_precision_environment():
    single, double = make_chain_env(2), make_chain_env(2)
    double.transform.double()
    check_env_specs(double)
    actions = actions_for(single, 3)
    single.set_seed(7)
    double.set_seed(7)
    assert_close_and_of_the_same_precision(play(double, actions), play(single, actions))
