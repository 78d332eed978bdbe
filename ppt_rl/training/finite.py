"""Training states that are not finite: found before they can spread or be saved."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import torch
from torch import Tensor, nn

__all__ = ["TrainingDiverged", "first_not_finite", "require_finite_update", "size_of"]


class TrainingDiverged(RuntimeError):
    """Raised for an update of the networks that is not finite; nothing of it is saved."""


def first_not_finite(state: Any) -> str | None:
    """Find the first number in a state that is NaN or infinite.

    Args:
        state: tensors and numbers, nested in mappings and sequences; an object with a ``state_dict`` stands for that.
            Buffers of a module may be infinite, such as the scale of an input that never changes, but not NaN.

    Returns:
        Name of the entry, with dots between the levels, or None if there is none.
    """
    for name, value, is_buffer in _walk(state, "", False):
        if isinstance(value, Tensor) and bool((torch.isnan(value) if is_buffer else ~torch.isfinite(value)).any()):
            return name
        if isinstance(value, float) and not math.isfinite(value):
            return name
    return None


def size_of(state: Any) -> int:
    """Bytes of the tensors in a state.

    Args:
        state: tensors and numbers, as for :func:`first_not_finite`.

    Returns:
        Their sum [B].
    """
    return sum(value.nbytes for _, value, _ in _walk(state, "", False) if isinstance(value, Tensor))


def require_finite_update(**losses: Tensor) -> None:
    """Raise before a step of the optimizer that would make the networks NaN or infinite.

    Args:
        **losses: scalars of the step, by name: its losses and the norm of its gradient.

    Raises:
        TrainingDiverged: if one is not finite; it names the first.
    """
    if math.isfinite(sum(losses.values())):
        return
    for name, value in losses.items():
        if not math.isfinite(value):
            raise TrainingDiverged(f"{name} is {float(value)}")


def _walk(state: Any, name: str, is_buffer: bool) -> Iterator[tuple[str, Any, bool]]:
    """Tensors and numbers of a state, each with its name and whether it is a buffer of a module."""
    buffers = {key for key, _ in state.named_buffers()} if isinstance(state, nn.Module) else set()
    if hasattr(state, "state_dict"):
        state = state.state_dict()
    if isinstance(state, Mapping):
        parts = state.items()
    elif isinstance(state, (list, tuple)):
        parts = enumerate(state)  # type: ignore[assignment]
    else:
        yield name, state, is_buffer
        return
    for key, value in parts:
        yield from _walk(value, f"{name}.{key}" if name else str(key), key in buffers)
