"""Checks that refuse bad input early: shapes, finiteness, ranges."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

__all__ = ["require_finite", "require_last_dim", "require_positive", "require_ranges"]


def require_finite(name: str, value: Tensor) -> None:
    """Raise if ``value`` contains NaN or infinity.

    On a GPU the check does not synchronise with the host: it fails later, as a device-side assertion. It is left out
    where no numbers are at hand: under ``torch.compile``, ``torch.export`` and ``torch.func`` (``vmap``, ``grad``).

    Args:
        name: what the tensor is, for the error message.
        value: any tensor.

    Raises:
        ValueError: if an entry of a CPU tensor is not finite.
    """
    if torch.compiler.is_compiling() or torch._C._functorch.peek_interpreter_stack() is not None:
        return
    # If the sum is finite, so is every entry. The converse fails on overflow only: then each entry is checked.
    if value.device.type != "cpu":
        torch._assert_async(torch.isfinite(value).all(), f"{name} is not finite")
        return
    if not math.isfinite(value.detach().sum()) and not bool(torch.isfinite(value).all()):
        bad = int((~torch.isfinite(value)).sum())
        raise ValueError(
            f"{name} holds {bad} NaN or infinite entries of {value.numel()} (shape {tuple(value.shape)}); "
            "expected finite numbers. Look for a diverged policy or a bad observation upstream."
        )


def require_last_dim(name: str, value: Tensor, size: int) -> None:
    """Raise if the last dimension of ``value`` is not ``size``.

    Args:
        name: what the tensor is, for the error message.
        value: any tensor.
        size: expected size of its last dimension.

    Raises:
        ValueError: if the sizes differ.
    """
    if value.ndim == 0 or value.shape[-1] != size:
        raise ValueError(f"{name} has shape {tuple(value.shape)}; expected (*batch, {size}).")


def require_positive(name: str, value: float, unit: str = "") -> float:
    """Return ``value`` as a float; raise unless it is positive and finite.

    Args:
        name: name of the parameter, for the error message.
        value: the number.
        unit: its unit, for the error message.

    Returns:
        The number as a ``float``.

    Raises:
        ValueError: if the number is not finite or not above zero.
    """
    number = float(value)
    if not math.isfinite(number) or number <= 0.0:
        raise ValueError(f"{name} is {value}; expected a finite number above 0 {unit}".rstrip() + ".")
    return number


def require_ranges(ranges: Any) -> None:
    """Raise if a range of a dataclass of ranges is empty; its lower bound may equal its upper bound.

    Args:
        ranges: a dataclass instance in which every field is a pair ``(low, high)``.

    Raises:
        ValueError: if ``low <= high`` does not hold for a field.
    """
    for name, (low, high) in vars(ranges).items():
        if not low <= high:
            raise ValueError(f"{type(ranges).__name__}.{name} is ({low}, {high}); expected low <= high.")
