"""Checks of single arguments: numbers, whole numbers, vectors, types. Each returns the argument in its proper type."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

__all__ = ["require_in_range", "require_instance", "require_number", "require_numbers", "require_whole", "shown"]

_WORDS = {1: "one", 2: "two", 3: "three", 6: "six", 7: "seven"}


def require_number(name: str, value: Any, expected: str) -> float:
    """Return ``value`` as a float; raise unless it is a finite number. Text and truth values are none.

    Args:
        name: name of the parameter, for the error message.
        value: the number.
        expected: what is expected, for the error message.

    Returns:
        The number as a ``float``.

    Raises:
        ValueError: if it is no finite number.
    """
    try:
        number = math.nan if isinstance(value, str | bytes | bool) else float(value)
    except (TypeError, ValueError, OverflowError, RuntimeError) as error:
        raise ValueError(f"{name} is {shown(value)}; expected {expected}.") from error
    if not math.isfinite(number):
        raise ValueError(f"{name} is {shown(value)}; expected {expected}.")
    return number


def require_in_range(name: str, value: float, low: float, high: float = math.inf, unit: str = "") -> float:
    """Return ``value`` as a float; raise unless it is finite and in a closed interval.

    Args:
        name: name of the parameter, for the error message.
        value: the number.
        low: lower end.
        high: upper end; infinity for none.
        unit: unit of the number, for the error message.

    Returns:
        The number as a ``float``.

    Raises:
        ValueError: if the number is not finite or outside the interval.
    """
    bounds = f"of at least {low:g}" if math.isinf(high) else f"from {low:g} to {high:g}"
    expected = f"a finite number {bounds} {unit}".rstrip()
    number = require_number(name, value, expected)
    if not low <= number <= high:
        raise ValueError(f"{name} is {value}; expected {expected}.")
    return number


def require_whole(name: str, value: int, low: int = 1, high: int | None = None) -> int:
    """Return ``value`` as an int; raise unless it is a whole number within bounds.

    Args:
        name: name of the parameter, for the error message.
        value: the number.
        low: smallest number.
        high: largest number; None for none.

    Returns:
        The number as an ``int``.

    Raises:
        ValueError: if the number is not whole or out of bounds.
    """
    bounds = f"of at least {low}" if high is None else f"from {low} to {high}"
    number = require_number(name, value, f"a whole number {bounds}")
    if number != round(number) or number < low or (high is not None and number > high):
        raise ValueError(f"{name} is {value}; expected a whole number {bounds}.")
    return int(value)


def require_numbers(name: str, values: Any, counts: Sequence[int], *, low: float = -math.inf, unit: str = "") -> Tensor:
    """Return numbers as a vector; raise unless there are as many finite ones as expected.

    Args:
        name: name of the parameter, for the error message.
        values: one number or a sequence of them.
        counts: how many there may be.
        low: smallest number.
        unit: unit of the numbers, for the error message.

    Returns:
        ``(n,)`` numbers in torch's default precision.

    Raises:
        ValueError: if their number does not fit, or one is not finite or below ``low``.
    """
    count = " or ".join(_WORDS.get(number, str(number)) for number in counts)
    if math.isinf(low):
        expected = f"{count} finite numbers" + (f" [{unit}]" if unit else "")
    else:
        expected = f"{count} numbers of at least {low:g} {unit}".rstrip()
    try:
        vector = torch.as_tensor(values, dtype=torch.get_default_dtype()).reshape(-1)
    except (TypeError, ValueError, RuntimeError) as error:
        raise ValueError(f"{name} is {shown(values)}; expected {expected}.") from error
    if vector.numel() not in counts or not bool(vector.isfinite().all() & (vector >= low).all()):
        raise ValueError(f"{name} is {shown(values)}; expected {expected}.")
    return vector


def require_instance(name: str, value: Any, *kinds: type) -> None:
    """Raise unless ``value`` is of an expected type.

    Args:
        name: name of the parameter, for the error message.
        value: any object.
        *kinds: the types.

    Raises:
        ValueError: if it is of none of them.
    """
    if not isinstance(value, kinds):
        expected = " or ".join(kind.__name__ for kind in kinds)
        raise ValueError(f"{name} is {shown(value)}, of type {type(value).__name__}; expected {expected}.")


def shown(value: Any) -> str:
    """A value as messages show it, in one line: text in quotes, a long one cut.

    Args:
        value: any object.

    Returns:
        The text.
    """
    text = " ".join((repr(value) if isinstance(value, str) else str(value)).split())
    return text if len(text) <= 80 else f"{text[:77]}..."
