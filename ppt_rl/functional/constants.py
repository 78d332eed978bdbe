"""Constants as operands of tensors."""

from __future__ import annotations

import math
from functools import lru_cache

import torch
from torch import Tensor

from ppt_rl.functional.checks import is_readable

__all__ = ["constant"]


def constant(value: float, like: Tensor) -> Tensor | float:
    """A number as an operand for a tensor: ``constant(2.0, x) * x``.

    torch makes a tensor of a Python number at every operation, which takes as long as the operation itself on a few
    entries. A control step of one environment has about thirty, so here each number becomes a tensor once. The result
    is the same to the bit, but for a number that is divided by a tensor: there torch multiplies with the reciprocal.

    Args:
        value: the number.
        like: the tensor that it meets.

    Returns:
        A tensor without dimensions in the precision of ``like``, which nobody may change. The number itself on a GPU,
        for a subclass of tensor, and where nothing is computed yet (``torch.compile``, ``torch.func``).
    """
    is_minus_zero = value == 0 and math.copysign(1.0, value) < 0  # equal to zero, so it would find zero's tensor
    if is_minus_zero or type(like) is not Tensor or not is_readable(like):
        return value
    return _tensor(value, like.dtype)


@lru_cache(maxsize=1024)
def _tensor(value: float, dtype: torch.dtype) -> Tensor:
    with torch.inference_mode(False):  # used outside of it too
        return torch.tensor(value, dtype=dtype, device="cpu")
