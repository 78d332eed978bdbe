"""Checks of the shapes and types of tensors that belong together."""

from __future__ import annotations

from itertools import zip_longest

import torch
from torch import Tensor

from ppt_rl.functional.argument_checks import require_instance

__all__ = ["require_bool", "require_same_batch", "require_trailing"]


def require_trailing(name: str, value: Tensor, *sizes: int | str) -> None:
    """Raise unless the last dimensions of ``value`` have the expected sizes.

    Args:
        name: what the tensor is, for the error message.
        value: any tensor.
        *sizes: expected sizes of its last dimensions; a letter stands for any size.

    Raises:
        ValueError: if the sizes differ, or it is no tensor.
    """
    require_instance(name, value, Tensor)
    found = value.shape[-len(sizes) :]
    if len(found) < len(sizes) or any(got != size for got, size in zip(found, sizes, strict=True) if size != str(size)):
        wanted = ", ".join(map(str, sizes))
        raise ValueError(f"{name} has shape {tuple(value.shape)}; expected (*batch, {wanted}).")


def require_same_batch(**values: Tensor) -> None:
    """Raise unless the leading dimensions, all but the last one, of some tensors broadcast.

    Args:
        **values: tensors by name.

    Raises:
        ValueError: if they do not.
    """
    first = None
    for value in values.values():
        batch = value.shape[:-1]
        if batch and first is not None and batch != first:
            break
        first = batch or first
    else:  # equal, or without a batch: the usual case, decided without calling torch
        return
    dims = zip_longest(*(reversed(value.shape[:-1]) for value in values.values()), fillvalue=1)
    if any(len({size for size in sizes if size != 1}) > 1 for sizes in dims):
        shapes = ", ".join(f"{name} {tuple(value.shape)}" for name, value in values.items())
        raise ValueError(f"the shapes are {shapes}; expected leading dimensions (*batch) that are equal or broadcast.")


def require_bool(name: str, value: Tensor) -> None:
    """Raise unless ``value`` is a tensor of booleans.

    Args:
        name: what the tensor is, for the error message.
        value: any tensor.

    Raises:
        ValueError: if it is of another type.
    """
    require_instance(name, value, Tensor)
    if value.dtype is not torch.bool:
        raise ValueError(f"{name} is of {value.dtype}; expected torch.bool. Compare it with a number, or use .bool().")
