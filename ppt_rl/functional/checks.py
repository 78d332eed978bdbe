"""Refuse bad tensors before they do damage: shapes, finiteness, ranges."""

from __future__ import annotations

import math

import torch
from torch import Tensor

__all__ = ["require_finite", "require_last_dim", "require_positive"]


def require_finite(name: str, value: Tensor) -> None:
    """Raise when ``value`` holds NaN or infinity.

    On a GPU the check is asynchronous (no host synchronisation) and surfaces as a device assertion.

    Args:
        name: what the tensor is, for the message.
        value: any tensor.

    Raises:
        ValueError: if an entry is not finite (CPU tensors).
    """
    # A sum is finite exactly when every term is (up to overflow, which the slow path resolves).
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
    """Raise when the last dimension of ``value`` is not ``size``.

    Args:
        name: what the tensor is, for the message.
        value: any tensor.
        size: expected size of its last dimension.

    Raises:
        ValueError: if the sizes differ.
    """
    if value.ndim == 0 or value.shape[-1] != size:
        raise ValueError(f"{name} has shape {tuple(value.shape)}; expected (*batch, {size}).")


def require_positive(name: str, value: float, unit: str = "") -> float:
    """Return ``value`` as a float, refusing anything that is not positive and finite.

    Args:
        name: name of the parameter, for the message.
        value: the number.
        unit: its unit, for the message.

    Returns:
        The number as ``float``.

    Raises:
        ValueError: if the number is not finite or not above zero.
    """
    number = float(value)
    if not math.isfinite(number) or number <= 0.0:
        raise ValueError(f"{name} is {value}; expected a finite number above 0 {unit}".rstrip() + ".")
    return number
