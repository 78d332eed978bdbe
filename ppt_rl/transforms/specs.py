"""Specs of entries, and where they go in composite specs that may be nested."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tensordict.utils import NestedKey, unravel_key
from torchrl.data import Composite, TensorSpec, Unbounded

__all__ = ["nest_of", "real", "replace_leaf", "set_leaf"]


def real(like: TensorSpec, *shape: int) -> Unbounded:
    """Spec of real numbers.

    Args:
        like: a spec with the dtype and device.
        *shape: of the entry, batch included.

    Returns:
        The spec, without bounds.
    """
    return Unbounded(shape=shape, dtype=like.dtype, device=like.device)


def nest_of(root: Any, key: NestedKey) -> Any:
    """The nest that an entry lies in.

    Args:
        root: a tensordict or composite spec.
        key: of the entry.

    Returns:
        The nested tensordict or spec; the root itself for an entry at the root.
    """
    key = unravel_key(key)
    return root[key[:-1]] if isinstance(key, tuple) else root


def replace_leaf(spec: Composite, key: NestedKey, leaf: TensorSpec, owner: str) -> Composite:
    """Replace an entry of a composite spec, which must be there.

    Args:
        spec: the composite, changed in place.
        key: of the entry.
        leaf: the new spec of the entry.
        owner: name of the transform, for the message.

    Returns:
        The composite.

    Raises:
        KeyError: if there is no such entry.
    """
    if key not in spec.keys(True, True):
        raise KeyError(f"{owner} acts on {key!r}; the environment's action keys are {list(spec.keys(True, True))}.")
    spec[key] = leaf
    return spec


def set_leaf(spec: Composite, key: NestedKey, leaf: TensorSpec, examples: Sequence[Composite] = ()) -> None:
    """Set an entry of a composite spec, and make the nest that it lies in where there is none yet.

    Args:
        spec: the composite, changed in place.
        key: of the entry.
        leaf: the spec of the entry.
        examples: composites that may hold the same nest; a new nest takes the shape that it has there, else ``spec``'s.
    """
    key = unravel_key(key)
    if not isinstance(key, tuple):
        spec[key] = leaf
        return
    nest = key[0]
    examples = [other[nest] for other in examples if nest in other.keys()]
    if nest not in spec.keys():
        spec[nest] = Composite(shape=examples[0].shape if examples else spec.shape, device=spec.device)
    set_leaf(spec[nest], key[1:] if len(key) > 2 else key[1], leaf, examples)
