"""Checks that refuse bad input early: shapes, finiteness, ranges.

Every check of the values of a tensor goes through :func:`is_readable`. Values on the CPU are looked at, and a violation
is an exception at once. To look at values on a GPU, the host would have to wait for all that was queued before, at
every control step. There a check is queued as a device-side assertion instead, so nothing that was computed from bad
input is ever read, and a shortcut that depends on values is not taken.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from numbers import Integral, Real
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ppt_rl.functional.argument_checks import require_number, shown

__all__ = [
    "Bounds",
    "all_at_most",
    "are_finite",
    "is_readable",
    "none_true",
    "require_all",
    "require_at_most",
    "require_bounds",
    "require_finite",
    "require_last_dim",
    "require_positive",
    "require_ranges",
]


class Bounds(NamedTuple):
    """Smallest and largest value of an option; two whole numbers ask for a whole number.

    Attributes:
        low: smallest value.
        high: largest value: far beyond any sensible use, but within what a machine can hold and finish.
        unit: unit of the option, for the message.
    """

    low: float
    high: float
    unit: str = ""

    def __str__(self) -> str:
        """What is expected, in words."""
        kind = "a whole number" if self.whole else "a number"
        return f"{kind} from {self.low:g} to {self.high:.15g} {self.unit}".rstrip()

    @property
    def whole(self) -> bool:
        """Whether only whole numbers fit."""
        return isinstance(self.low, int) and isinstance(self.high, int)

    def hold(self, value: Any) -> bool:
        """Whether a value is a number within the bounds; NaN is not, and neither is a truth value.

        Args:
            value: anything.

        Returns:
            Whether it fits.
        """
        number: Any = value
        is_number = isinstance(value, Integral if self.whole else Real) and not isinstance(value, bool)
        return is_number and bool(self.low <= number <= self.high)


def require_at_most(name: str, value: float, high: float, advice: str) -> None:
    """Raise if a size is larger than what a machine can hold or finish.

    Args:
        name: what the number is, for the error message.
        value: the number.
        high: its largest value.
        advice: what to change.

    Raises:
        ValueError: if the number is larger, or not a number.
    """
    if not value <= high:
        raise ValueError(f"{name} is {value:g}; expected at most {high:g}: {advice}.")


def require_bounds(options: Any, bounds: Mapping[str, Bounds]) -> None:
    """Raise if a numeric field of a dataclass lies outside its bounds, or is not finite.

    Args:
        options: a dataclass instance. Every entry of a tuple is checked. A number without bounds must be finite.
        bounds: bounds by the name of the field; names of other fields are passed over.

    Raises:
        ValueError: if a number is out of bounds or not finite.
    """
    for name, value in vars(options).items():
        limits = bounds.get(name)
        for entry in value if isinstance(value, (tuple, list)) else (value,):
            if limits is not None and not limits.hold(entry):
                raise ValueError(f"{name} is {entry!r}; expected {limits}.")
            if isinstance(entry, Real) and not isinstance(entry, Integral) and not math.isfinite(entry):
                raise ValueError(f"{name} is {entry}; expected a finite number.")


def is_readable(value: Tensor) -> bool:
    """Whether the host may look at the values of a tensor without waiting for a device.

    Args:
        value: any tensor.

    Returns:
        True for tensors on the CPU, but for those that only stand for values, under ``torch.compile``, ``torch.export``
        and ``torch.func`` (``vmap``, ``grad``).
    """
    return value.is_cpu and not _is_traced()


def none_true(condition: Tensor) -> bool:
    """Whether a condition is known to hold nowhere.

    Args:
        condition: boolean tensor.

    Returns:
        False where an entry is True, or where nothing is known, because the tensor is not readable.
    """
    return is_readable(condition) and not (condition if condition.numel() == 1 else condition.any())


def all_at_most(value: Tensor, most: float) -> bool:
    """Whether every entry of a tensor is known to be at most a number.

    Args:
        value: any tensor with at least one entry.
        most: the number.

    Returns:
        False where an entry is larger or NaN, or where nothing is known, because the tensor is not readable.
    """
    return is_readable(value) and value.numel() > 0 and _without_gradient(value).max().item() <= most


def require_all(condition: Tensor, message: str) -> None:
    """Raise unless a condition holds everywhere.

    On a GPU the check does not synchronise with the host: it fails later, as a device-side assertion. It is left out
    where no numbers are at hand, as in :func:`require_finite`.

    Args:
        condition: boolean tensor.
        message: what came, what was expected and what to do.

    Raises:
        ValueError: if an entry of a CPU tensor is False.
    """
    if not is_readable(condition):
        if not _is_traced():
            torch._assert_async(condition.all(), message)
    elif not condition.all():
        raise ValueError(message)


def _without_gradient(value: Tensor) -> Tensor:
    """A tensor detached from its graph; at no cost where there is none."""
    return value.detach() if value.requires_grad else value


def _is_traced() -> bool:
    """Whether this runs inside ``torch.compile`` or ``torch.vmap``, where nothing may depend on a value."""
    return torch._C._functorch.peek_interpreter_stack() is not None or torch.compiler.is_compiling()


def are_finite(value: Tensor) -> bool:
    """Whether a tensor is known to have finite entries only, from their sum.

    Args:
        value: any tensor.

    Returns:
        False where an entry is not finite, or where nothing is known: the sum overflows, or the tensor is not readable.
    """
    if not is_readable(value):
        return False
    value = _without_gradient(value)
    return math.isfinite((value if value.numel() == 1 else value.sum()).item())


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
    if are_finite(value) or _is_traced():
        return
    if not is_readable(value):
        torch._assert_async(torch.isfinite(value).all(), f"{name} is not finite")
    # If the sum is finite, so is every entry. The converse fails on overflow only: then each entry is checked.
    elif not torch.isfinite(value).all():
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
        ValueError: if the sizes differ, or it is no tensor.
    """
    if not isinstance(value, Tensor):
        raise ValueError(
            f"{name} is {shown(value)}, of type {type(value).__name__}; expected a tensor (*batch, {size})."
        )
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
    expected = f"a finite number above 0 {unit}".rstrip()
    number = require_number(name, value, expected)
    if number <= 0.0:
        raise ValueError(f"{name} is {value}; expected {expected}.")
    return number


def require_ranges(ranges: Any) -> None:
    """Raise if a range of a dataclass of ranges is empty; its lower bound may equal its upper bound.

    Args:
        ranges: a dataclass instance in which every field is a pair ``(low, high)``.

    Raises:
        ValueError: if a field is no pair of finite numbers, or ``low <= high`` does not hold for it.
    """
    for name, pair in vars(ranges).items():
        full = f"{type(ranges).__name__}.{name}"
        numbers = isinstance(pair, Sequence) and len(pair) == 2 and all(isinstance(end, Real) for end in pair)
        if not numbers or any(math.isinf(end) for end in pair):
            raise ValueError(f"{full} is {shown(pair)}; expected a pair (low, high) of finite numbers.")
        low, high = pair
        if not low <= high:
            raise ValueError(f"{full} is ({low}, {high}); expected low <= high.")
