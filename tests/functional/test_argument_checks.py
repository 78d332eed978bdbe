import math

import numpy as np
import pytest
import torch

from ppt_rl.functional.argument_checks import (
    require_in_range,
    require_instance,
    require_number,
    require_numbers,
    require_whole,
    shown,
)
from ppt_rl.functional.checks import require_positive

NO_NUMBERS = [math.nan, math.inf, -math.inf, "1.0", "", None, True, [1.0], (), torch.zeros(2), 10**400]


@pytest.mark.parametrize("bad", NO_NUMBERS)
def test_what_is_no_finite_number_is_refused_by_name_with_what_came(bad):
    for require in (
        lambda value: require_number("gain", value, "a finite number"),
        lambda value: require_in_range("gain", value, 0.0, 2.0),
        lambda value: require_positive("gain", value),
        lambda value: require_whole("gain", value, 0, 9),
    ):
        with pytest.raises(ValueError, match=r"gain is [\s\S]*; expected a (finite|whole) number") as error:
            require(bad)
        assert shown(bad) in str(error.value)
        assert "\n" not in str(error.value)


@pytest.mark.parametrize("good", [1, 1.0, np.float32(1.0), np.int64(1), torch.tensor(1.0)])
def test_numbers_of_every_kind_come_back_as_floats_and_ints(good):
    for value in (require_number("gain", good, "a number"), require_in_range("gain", good, 1.0, 1.0)):
        assert value == 1.0
        assert type(value) is float
    assert require_whole("count", good) == 1
    assert type(require_whole("count", good)) is int


@pytest.mark.parametrize(("value", "fits"), [(-0.1, False), (0.0, True), (2.0, True), (2.1, False)])
def test_a_range_includes_its_ends_and_nothing_beyond(value, fits):
    if fits:
        assert require_in_range("share", value, 0.0, 2.0, "m") == value
    else:
        with pytest.raises(ValueError, match=rf"share is {value}; expected a finite number from 0 to 2 m\."):
            require_in_range("share", value, 0.0, 2.0, "m")


def test_a_range_without_an_upper_end_says_so():
    assert require_in_range("mass", 1e300, 0.0) == 1e300
    with pytest.raises(ValueError, match=r"mass is -1.0; expected a finite number of at least 0 kg\."):
        require_in_range("mass", -1.0, 0.0, unit="kg")


@pytest.mark.parametrize("bad", [0, -1, 1.5, 11])
def test_a_number_that_is_not_whole_or_out_of_bounds_is_refused(bad):
    with pytest.raises(ValueError, match=rf"count is {bad}; expected a whole number from 1 to 10\."):
        require_whole("count", bad, 1, 10)


def test_a_large_whole_number_keeps_every_digit():
    assert require_whole("seed", 2**63 - 1) == 2**63 - 1


@pytest.mark.parametrize(
    ("values", "counts"), [((1, 2, 3), (3,)), (0.5, (1, 6)), ([1.0] * 6, (1, 6)), (np.ones(3), (3,))]
)
def test_vectors_come_back_as_tensors(values, counts):
    vector = require_numbers("gains", values, counts)
    assert vector.dtype is torch.get_default_dtype()
    assert vector.shape == (np.size(values),)


@pytest.mark.parametrize(
    "bad", [(1, 2), (1.0, math.nan, 0.0), (1.0, math.inf, 0.0), (1.0, -0.1, 0.0), "far", None, [[1], []]]
)
def test_vectors_of_another_length_or_with_impossible_numbers_are_refused(bad):
    with pytest.raises(ValueError, match=r"lead is .*; expected three numbers of at least 0 m\."):
        require_numbers("lead", bad, (3,), low=0.0, unit="m")


def test_a_vector_may_have_one_of_several_lengths():
    with pytest.raises(ValueError, match=r"gains is \(1, 2\); expected one or six finite numbers \[N/m\]\."):
        require_numbers("gains", (1, 2), (1, 6), unit="N/m")


def test_an_object_of_another_type_is_named_with_its_type():
    require_instance("name", "panda", str, bytes)
    with pytest.raises(ValueError, match=r"name is 7, of type int; expected str or bytes\."):
        require_instance("name", 7, str, bytes)


def test_long_values_are_cut_to_one_line_of_a_message():
    assert shown("a\nb") == "'a\\nb'"
    assert len(shown(torch.zeros(100, 100))) == 80
    assert "\n" not in shown(torch.zeros(3, 3))
