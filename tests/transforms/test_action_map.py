"""A few numbers that a policy decides on, and the many that follow from them."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close
from torchrl.envs import TransformedEnv

from ppt_rl.transforms import ActionMapTransform
from tests.transforms.mocks import MockArmEnv

MATRIX = torch.arange(21.0, dtype=torch.float64).reshape(7, 3) / 10 - 1


def mapped(action: torch.Tensor, matrix: torch.Tensor = MATRIX) -> torch.Tensor:
    return ActionMapTransform(matrix).inv(TensorDict(action=action, batch_size=action.shape[:-1]))["action"]


def test_the_map_is_linear_and_its_columns_are_what_one_unit_of_each_number_does():
    one, other = torch.randn(2, 5, 3, dtype=torch.float64)
    assert_close(mapped(2 * one - other), 2 * mapped(one) - mapped(other))
    assert_close(mapped(torch.eye(3, dtype=torch.float64)), MATRIX.mT)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_result_has_the_precision_of_the_action(dtype):
    assert mapped(torch.ones(2, 3, dtype=dtype)).dtype == dtype


def test_a_change_of_the_matrix_that_was_passed_changes_nothing():
    matrix = torch.ones(2, 1)
    transform = ActionMapTransform(matrix)
    matrix.zero_()
    assert transform.inv(TensorDict(action=torch.ones(1, 1), batch_size=[1]))["action"].tolist() == [[1.0, 1.0]]


def test_outside_the_action_has_a_number_for_each_column():
    env = TransformedEnv(MockArmEnv((2,)), ActionMapTransform(MATRIX))
    assert env.full_action_spec["action"].shape == (2, 3)
    assert env.base_env.full_action_spec["action"].shape == (2, 7)


def test_an_environment_whose_action_has_another_size_is_refused():
    with pytest.raises(ValueError, match=r"matrix has 6 rows, but the action 'action' .* has shape \(2, 7\)"):
        TransformedEnv(MockArmEnv((2,)), ActionMapTransform(MATRIX[:6])).reset()


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_an_action_that_is_not_finite_is_refused(value):
    with pytest.raises(ValueError, match=r"action \(mapped\)"):
        mapped(torch.full((1, 3), value))


def test_an_action_of_another_size_is_refused():
    with pytest.raises(ValueError, match=r"action \(mapped\).*\(1, 7\)"):
        mapped(torch.ones(1, 7))
