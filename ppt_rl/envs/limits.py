"""Bounds on the arguments of environments, so that a slip of the keyboard is an error at once and not a hang."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch

from ppt_rl.functional.argument_checks import require_number, require_whole, shown
from ppt_rl.functional.checks import require_ranges

__all__ = [
    "Bound",
    "require_bounded_ranges",
    "require_count",
    "require_device",
    "require_real",
    "require_weights",
    "require_within",
]

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
    expected = f"a number from {low:g} to {high:g} {unit}".rstrip()
    number = require_number(name, value, expected)
    if not low <= number <= high:
        raise ValueError(f"{name} is {value}; expected {expected}.")
    return number


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
    number = require_whole(name, value)  # type: ignore[arg-type]
    if number > most:
        raise ValueError(f"{name} is {value}; expected at most {most}.")
    return number


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


def require_weights(weights: Any) -> None:
    """Raise unless every field of a dataclass of weights is a finite number.

    Args:
        weights: a dataclass instance in which every field is a number.

    Raises:
        ValueError: if a field is none.
    """
    for name, value in vars(weights).items():
        require_number(f"{type(weights).__name__}.{name}", value, "a finite number")


def require_real(name: str, dtype: torch.dtype) -> torch.dtype:
    """Return a precision; raise unless it is one of real numbers.

    Args:
        name: name of the argument, for the error message.
        dtype: the precision.

    Returns:
        The precision.

    Raises:
        ValueError: if it is another type.
    """
    if not isinstance(dtype, torch.dtype) or not dtype.is_floating_point:
        raise ValueError(f"{name} is {shown(dtype)}; expected a type of real numbers, such as torch.float32.")
    return dtype


def require_device(name: str, device: torch.device | str) -> torch.device:
    """Return a device; raise unless torch knows its name.

    Args:
        name: name of the argument, for the error message.
        device: the device.

    Returns:
        The device.

    Raises:
        ValueError: if torch does not know it, or it is a GPU that this machine or this build of torch lacks.
    """
    try:
        found = torch.device(device)
    except (RuntimeError, TypeError) as error:
        raise ValueError(f"{name} is {shown(device)}; expected a device of torch, such as 'cpu' or 'cuda'.") from error
    if found.type == "cuda" and (found.index or 0) >= torch.cuda.device_count():
        raise ValueError(
            f"{name} is {shown(str(device))}, and torch {torch.__version__} sees {torch.cuda.device_count()} GPUs "
            "here; expected a device that it sees. Use device='cpu', or install a driver and torch with CUDA."
        )
    return found
