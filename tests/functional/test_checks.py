import math
from dataclasses import dataclass

import pytest
import torch

from ppt_rl.functional.checks import require_finite, require_last_dim, require_positive, require_ranges


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_the_error_counts_the_bad_entries(bad):
    with pytest.raises(ValueError, match=r"wrench holds 1 NaN or infinite entries of 6 \(shape \(2, 3\)\)"):
        require_finite("wrench", torch.tensor([[0.0, 1.0, 2.0], [3.0, bad, 5.0]]))


def test_infinities_that_cancel_are_refused():
    with pytest.raises(ValueError, match="holds 2 NaN or infinite"):
        require_finite("wrench", torch.tensor([math.inf, -math.inf]))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_finite_numbers_whose_sum_overflows_pass(dtype):
    require_finite("wrench", torch.full((4,), torch.finfo(dtype).max, dtype=dtype))


def test_finite_tensors_that_need_gradients_or_are_empty_pass():
    require_finite("wrench", torch.ones(3, requires_grad=True))
    require_finite("wrench", torch.ones(0, 6))


@pytest.mark.parametrize("shape", [(), (6,), (7, 6)])
def test_a_wrong_last_dimension_names_the_tensor_and_its_shape(shape):
    with pytest.raises(ValueError, match=r"pose has shape .*; expected \(\*batch, 7\)"):
        require_last_dim("pose", torch.zeros(shape), 7)


@pytest.mark.parametrize("shape", [(7,), (0, 7), (2, 3, 7)])
def test_any_batch_before_the_right_last_dimension_passes(shape):
    require_last_dim("pose", torch.zeros(shape), 7)


@pytest.mark.parametrize("bad", [0, -1.0, math.nan, math.inf])
def test_numbers_that_are_not_positive_and_finite_are_refused(bad):
    with pytest.raises(ValueError, match=rf"dt is {bad}; expected a finite number above 0 s\."):
        require_positive("dt", bad, "s")


def test_a_positive_number_comes_back_as_float():
    value = require_positive("num", 3)
    assert value == 3.0
    assert isinstance(value, float)


@dataclass(frozen=True)
class Ranges:
    length: tuple[float, float] = (0.1, 0.2)
    count: tuple[int, int] = (3, 3)


def test_ranges_may_be_a_single_number_but_not_empty():
    require_ranges(Ranges())
    for bad in ((0.2, 0.1), (math.nan, 0.2), (0.1, math.nan)):
        with pytest.raises(ValueError, match=r"Ranges\.length is \(.*\); expected low <= high\."):
            require_ranges(Ranges(length=bad))
