import math
from dataclasses import dataclass

import numpy as np
import pytest
import torch

from ppt_rl.functional.checks import (
    Bounds,
    require_at_most,
    require_bounds,
    require_finite,
    require_last_dim,
    require_positive,
    require_ranges,
)


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


# -- bounds ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [0.0, 1, 1.0, np.float32(0.5), np.int64(1)])
def test_numbers_within_their_bounds_pass(value):
    assert Bounds(0.0, 1.0).hold(value)


@pytest.mark.parametrize("value", [-1e-9, 1.1, math.nan, math.inf, -math.inf, True, None, "0.5", (0.5,)])
def test_what_is_out_of_bounds_or_no_number_does_not_hold(value):
    assert not Bounds(0.0, 1.0).hold(value)


def test_a_number_that_no_float_can_hold_is_out_of_bounds():
    assert not Bounds(0.0, 1.0).hold(10**400)


@pytest.mark.parametrize(("value", "fits"), [(1, True), (np.int64(5), True), (2.0, False), (0, False), (6, False)])
def test_whole_bounds_ask_for_a_whole_number(value, fits):
    assert Bounds(1, 5).hold(value) == fits


def test_the_message_says_what_came_and_what_was_expected_with_its_unit():
    @dataclass
    class Options:
        length: float = 3.0
        count: int = 1

    bounds = {"length": Bounds(0.0, 2.0, "m"), "count": Bounds(1, 10**12), "other": Bounds(0, 1)}
    with pytest.raises(ValueError, match=r"^length is 3\.0; expected a number from 0 to 2 m\.$"):
        require_bounds(Options(), bounds)
    with pytest.raises(ValueError, match=r"^count is 0; expected a whole number from 1 to 1000000000000\.$"):
        require_bounds(Options(1.0, 0), bounds)
    require_bounds(Options(1.0), bounds)


def test_a_number_without_bounds_must_be_finite():
    @dataclass
    class Options:
        free: tuple[float, ...] = (1.0, math.nan)

    with pytest.raises(ValueError, match=r"^free is nan; expected a finite number\.$"):
        require_bounds(Options(), {})


@pytest.mark.parametrize("value", [5.5, math.nan, math.inf])
def test_a_size_that_is_too_large_is_refused_with_advice(value):
    with pytest.raises(ValueError, match=r"^steps is .*; expected at most 5: lower them\.$"):
        require_at_most("steps", value, 5, "lower them")
    require_at_most("steps", 5, 5, "lower them")
