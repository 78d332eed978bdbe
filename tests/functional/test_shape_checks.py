import pytest
import torch

from ppt_rl.functional.shape_checks import require_bool, require_same_batch, require_trailing


@pytest.mark.parametrize("shape", [(6, 7), (2, 6, 7), (0, 6, 1)])
def test_a_letter_stands_for_any_size(shape):
    require_trailing("jacobian", torch.zeros(shape), 6, "N")


@pytest.mark.parametrize("shape", [(), (6,), (7, 6), (6, 2, 7)])
def test_other_trailing_sizes_are_refused_with_the_shape_that_came(shape):
    with pytest.raises(ValueError, match=r"jacobian has shape \(.*\); expected \(\*batch, 6, N\)\.") as error:
        require_trailing("jacobian", torch.zeros(shape), 6, "N")
    assert str(tuple(shape)) in str(error.value)


def test_what_is_no_tensor_is_named_with_its_type():
    with pytest.raises(ValueError, match=r"mask is \[True\], of type list; expected Tensor"):
        require_trailing("mask", [True], "M")
    with pytest.raises(ValueError, match="mask is None, of type NoneType; expected Tensor"):
        require_bool("mask", None)


def test_batches_that_broadcast_pass_and_others_are_refused_by_name():
    require_same_batch(a=torch.zeros(2, 6), b=torch.zeros(6), c=torch.zeros(5, 1, 3))
    with pytest.raises(ValueError, match=r"the shapes are a \(2, 6\), b \(3, 6\); expected leading dimensions"):
        require_same_batch(a=torch.zeros(2, 6), b=torch.zeros(3, 6))


def test_a_mask_has_to_be_boolean():
    require_bool("mask", torch.ones(3, dtype=torch.bool))
    with pytest.raises(ValueError, match=r"mask is of torch.float32; expected torch.bool\. .*use \.bool\(\)\."):
        require_bool("mask", torch.ones(3))
