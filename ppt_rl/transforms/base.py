"""What the transforms of this library share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey, expand_as_right, unravel_key
from torch import Tensor
from torchrl.data import Composite, TensorSpec
from torchrl.envs import Transform

__all__ = ["ActionTransform", "StatefulTransform", "replace_leaf"]


class StatefulTransform(Transform):
    """A transform whose state lives in the tensordict: read from the root, written under ``"next"``.

    The state's keys are declared in ``full_state_spec`` and in the observation spec. A partial reset touches only its
    rows. State computed on the way in (``_inv_call``) waits for ``_step`` under a private root key, which never leaves
    the environment.

    Args:
        in_keys: as for :class:`torchrl.envs.Transform`.
        out_keys: likewise.
        in_keys_inv: likewise.
        out_keys_inv: likewise.
    """

    def _state_specs(self, batch: torch.Size, like: TensorSpec) -> dict[NestedKey, TensorSpec]:
        """Specs of the state's keys for an environment of a batch size; ``like`` has its dtype and device."""
        return {}

    def _like(self) -> TensorSpec:
        """A spec with the dtype and device of the state."""
        return next(iter(self.parent.full_action_spec.values(True, True)))

    def transform_input_spec(self, input_spec: Composite) -> Composite:
        """Declare the state in ``full_state_spec``."""
        state = input_spec["full_state_spec"]
        if state is None:
            state = Composite(shape=input_spec.shape, device=input_spec.device)
        nests = [self.parent.full_observation_spec, self.parent.full_action_spec]
        for key, spec in self._state_specs(self.parent.batch_size, self._like()).items():
            _set_spec(state, key, spec, nests)
        input_spec["full_state_spec"] = state
        return super().transform_input_spec(input_spec)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Declare the state as observations."""
        nests = [self.parent.full_action_spec]
        for key, spec in self._state_specs(self.parent.batch_size, self._like()).items():
            _set_spec(observation_spec, key, spec, nests)
        return observation_spec

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Return the tensordict as it is: offline there is nothing to add to stored observations."""
        return tensordict

    # -- the way of a value from _inv_call to _step -------------------------------------------------------------------

    def _stash(self, tensordict: TensorDictBase, key: NestedKey, value: Tensor) -> None:
        if self.parent is not None:
            tensordict.set(_private(key), value)

    def _unstash(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase, key: NestedKey) -> None:
        """Write a stashed value under next, keeping the old value in rows that do not step."""
        value = tensordict.get(_private(key))
        step = tensordict.get("_step", None)
        old = None if step is None else tensordict.get(key, None)
        if old is not None:
            value = torch.where(expand_as_right(step.reshape(tensordict.batch_size), value), value, old)
        next_tensordict.set(key, value)

    def _zeros(self, specs: dict[NestedKey, TensorSpec], like: TensorDictBase) -> dict[NestedKey, Tensor]:
        """Zeros of specs, with the leading dimensions that a tensordict of an environment without a lock has."""
        leading = like.shape[: like.ndim - len(self.parent.batch_size)]
        return {key: spec.zero(leading) for key, spec in specs.items()}

    def _restart(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase, key: NestedKey, initial: Tensor
    ) -> None:
        """Write the initial value into the rows that reset, keep the others."""
        old = tensordict.get(key, None)
        reset = self._reset_mask(tensordict, key)
        if old is not None and reset is not None:
            initial = torch.where(expand_as_right(reset, initial), initial, old)
        tensordict_reset.set(key, initial)

    def _reset_mask(self, tensordict: TensorDictBase, key: NestedKey) -> Tensor | None:
        """The reset signal that governs ``key``: the one in its own nest, else the root's; None means all rows."""
        key = unravel_key(key)
        prefix = key[:-1] if isinstance(key, tuple) else ()
        while True:
            mask = tensordict.get((*prefix, "_reset"), None)
            if mask is not None:
                return mask.squeeze(-1) if mask.ndim > tensordict.ndim + len(prefix) else mask
            if not prefix:
                return None
            prefix = prefix[:-1]


class ActionTransform(StatefulTransform):
    """A transform of the action on its way to the environment (``inv``); what comes back passes through.

    ``inv`` needs no environment. In a replay buffer ``extend`` applies it, so the buffer holds what was executed.

    Args:
        action_key: the action, read and written in place.
    """

    def __init__(self, action_key: NestedKey = "action") -> None:
        super().__init__(in_keys=[], out_keys=[], in_keys_inv=[action_key], out_keys_inv=[action_key])

    @property
    def action_key(self) -> NestedKey:
        """Key of the action."""
        return self.in_keys_inv[0]

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict

    def _like(self) -> TensorSpec:
        return self.parent.full_action_spec[self.action_key]

    def _require(self, tensordict: TensorDictBase, *keys: NestedKey) -> list[Tensor]:
        """Entries of the tensordict, or an error that names what is missing and what there is."""
        values: list[Any] = []
        for key in keys:
            value = tensordict.get(key, None)
            if value is None:
                present = sorted(str(k) for k in tensordict.keys(True, True))
                raise KeyError(f"{type(self).__name__} needs {key!r} in the tensordict; it holds {present}.")
            values.append(value)
        return values


def replace_leaf(spec: Composite, key: NestedKey, leaf: TensorSpec, owner: str) -> Composite:
    """Swap a leaf of a composite spec that must be there.

    Args:
        spec: the composite, changed in place.
        key: of the leaf.
        leaf: what to put there.
        owner: who asks, for the message.

    Returns:
        The composite.

    Raises:
        KeyError: if there is no such leaf.
    """
    if key not in spec.keys(True, True):
        raise KeyError(f"{owner} acts on {key!r}; the environment's action keys are {list(spec.keys(True, True))}.")
    spec[key] = leaf
    return spec


def _private(key: NestedKey) -> str:
    return "_" + "/".join(key) if isinstance(key, tuple) else f"_{key}"


def _set_spec(spec: Composite, key: NestedKey, leaf: TensorSpec, nests: Sequence[Composite]) -> None:
    """Set a leaf; a nest that is not there yet takes the shape that it has in one of ``nests``."""
    key = unravel_key(key)
    if isinstance(key, tuple):
        nest = key[0]
        nests = [other[nest] for other in nests if nest in other.keys()]
        if nest not in spec.keys():
            spec[nest] = Composite(shape=nests[0].shape if nests else spec.shape, device=spec.device)
        _set_spec(spec[nest], key[1:] if len(key) > 2 else key[1], leaf, nests)
    else:
        spec[key] = leaf
