"""Bounds on the arguments of environments, so that a slip of the keyboard is an error at once and not a hang."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from ppt_rl.functional.checks import require_ranges

__all__ = ["Bound", "require_bounded_ranges", "require_count", "require_within"]

#: Smallest and largest value, and unit.
Bound = tuple[float, float, str]


def require_within(name: str, value: float, bound: Bound) -> float:
    """Return a number as a float; raise unless it lies within bounds, which are included.

    Args:
        name: name of the argument, for the error message.
        value: the number.
        bound: smallest and largest value, and unit.

    Returns:
        The number.

    Raises:
        ValueError: if it is no finite number or out of bounds.
    """
    low, high, unit = bound
    if isinstance(value, bool) or not math.isfinite(value) or not low <= value <= high:
        raise ValueError(f"{name} is {value}; expected a number from {low:g} to {high:g} {unit}".rstrip() + ".")
    return float(value)


def require_count(name: str, value: float, most: int) -> int:
    """Return a number as an int; raise unless it is a whole number from 1 to a largest one.

    Args:
        name: name of the argument, for the error message.
        value: the number.
        most: largest number.

    Returns:
        The number.

    Raises:
        ValueError: if it is not whole or out of bounds.
    """
    if isinstance(value, bool) or not math.isfinite(value) or int(value) != value or value < 1:
        raise ValueError(f"{name} is {value}; expected a whole number of at least 1.")
    if value > most:
        raise ValueError(f"{name} is {value}; expected at most {most}.")
    return int(value)


def require_bounded_ranges(ranges: Any, bounds: Mapping[str, Bound]) -> None:
    """Raise if a range of a dataclass of ranges is empty or leaves its bounds.

    Args:
        ranges: a dataclass instance in which every field is a pair ``(low, high)``.
        bounds: of each field.

    Raises:
        ValueError: if ``low <= high`` does not hold for a field, or an end is not finite or out of bounds.
    """
    require_ranges(ranges)
    for name, ends in vars(ranges).items():
        for end in ends:
            require_within(f"an end of {type(ranges).__name__}.{name} {tuple(ends)}", end, bounds[name])
