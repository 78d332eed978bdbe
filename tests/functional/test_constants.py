"""A constant is the number that it stands for, wherever it meets a tensor."""

from __future__ import annotations

import math
import operator

import pytest
import torch
from torch._subclasses.fake_tensor import FakeTensorMode

from ppt_rl.functional.constants import constant
from tests.sampling import normal

NUMBERS = [0.0, -0.0, 1.0, -2.0, 0.3, 1 - 2.0**-21, 1e-30, 1e30, math.inf, math.nan]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("act", [operator.add, operator.sub, operator.mul, operator.truediv, operator.gt, operator.lt])
def test_the_result_is_that_of_the_number_to_the_bit(act, dtype: torch.dtype):
    for shape in ((1, 1), (3, 6), (128, 7)):
        value = normal(*shape).to(dtype) * 10.0 ** normal(*shape, seed=1).to(dtype)
        for number in NUMBERS:
            # torch multiplies a number that is divided by a tensor with the reciprocal, so it is not meant for that.
            for one, other in ((value, number), (number, value))[: 1 if act is operator.truediv else 2]:
                expected = act(one, other)
                found = act(*(constant(part, value) if part is number else part for part in (one, other)))
                assert found.dtype == expected.dtype
                assert torch.equal(found.nan_to_num(7.0), expected.nan_to_num(7.0))
                assert torch.equal(found.signbit() & ~found.isnan(), expected.signbit() & ~expected.isnan())


def test_whole_numbers_stay_whole():
    count = torch.tensor([[3], [5]])
    assert (count + constant(1, count)).tolist() == [[4], [6]]
    assert (count >= constant(5, count)).tolist() == [[False], [True]]


def test_each_precision_has_its_own():
    for dtype in (torch.float32, torch.float64, torch.float32):
        assert constant(0.1, torch.zeros(2, dtype=dtype)).dtype == dtype


def test_one_that_was_made_in_inference_mode_serves_outside_of_it():
    with torch.inference_mode():
        made = constant(0.123456, torch.zeros(2))
    value = torch.ones(2, requires_grad=True)
    assert constant(0.123456, value) is made
    (value * constant(0.123456, value) * value).sum().backward()
    torch.testing.assert_close(value.grad, torch.full((2,), 2 * 0.123456))


def test_where_nothing_is_computed_yet_it_is_the_number_itself():
    seen = []

    def law(value: torch.Tensor) -> torch.Tensor:
        seen.append(constant(2.5, value))
        return (value * seen[-1]).sum()

    torch.vmap(law)(torch.ones(3, 2))
    torch.func.grad(law)(torch.ones(2))
    torch.func.jvp(law, (torch.ones(2),), (torch.ones(2),))
    assert [type(value) for value in seen] == [float] * 3
    assert torch.func.grad(torch.func.grad(lambda x: (x * constant(2.5, x)) ** 2))(torch.tensor(1.0)) == 12.5


def test_neither_a_default_device_nor_tensors_without_values_reach_what_is_kept():
    value = torch.ones(2)
    with torch.device("meta"):
        assert (value * constant(0.7, value)).tolist() == pytest.approx([0.7, 0.7])
    with FakeTensorMode():
        assert type(constant(0.8, torch.ones(2))) is float
    assert (value * constant(0.8, value)).tolist() == pytest.approx([0.8, 0.8])
