"""What the transforms of this library share: state, actions, observers."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey, expand_as_right, unravel_key
from torch import Tensor
from torchrl.data import Composite, TensorSpec
from torchrl.envs import Transform

from ppt_rl.transforms.specs import set_leaf

__all__ = ["ActionTransform", "Entries", "ObserverTransform", "StatefulTransform"]

#: Entries of a tensordict by key.
Entries = dict[NestedKey, Any]


class StatefulTransform(Transform):
    """A transform whose state lives in the tensordict: it is read from the root and written under ``"next"``.

    The keys of the state are declared in ``full_state_spec`` and in the observation spec. A partial reset changes only
    the environments that reset, and an environment outside the ``_step`` mask keeps its state. State that is computed
    on the way in (``_inv_call``) waits for ``_step`` under a private root key, which never leaves the environment.

    Args:
        in_keys: as for :class:`torchrl.envs.Transform`.
        out_keys: likewise.
        in_keys_inv: likewise.
        out_keys_inv: likewise.
    """

    #: What the error about a missing entry adds, such as who writes that entry.
    _hint = ""

    def _state_specs(self, batch: torch.Size, like: TensorSpec) -> dict[NestedKey, TensorSpec]:
        """Specs of the state for an environment of this batch size; ``like`` has its dtype and device."""
        return {}

    def _like(self) -> TensorSpec:
        """A spec with the dtype and device of the state."""
        return next(iter(self.parent.full_action_spec.values(True, True)))

    def transform_input_spec(self, input_spec: Composite) -> Composite:
        """Declare the state in ``full_state_spec``."""
        state = input_spec["full_state_spec"]
        if state is None:
            state = Composite(shape=input_spec.shape, device=input_spec.device)
        examples = [self.parent.full_observation_spec, self.parent.full_action_spec]
        for key, spec in self._state_specs(self.parent.batch_size, self._like()).items():
            set_leaf(state, key, spec, examples)
        input_spec["full_state_spec"] = state
        return super().transform_input_spec(input_spec)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Declare the state as observations."""
        for key, spec in self._state_specs(self.parent.batch_size, self._like()).items():
            set_leaf(observation_spec, key, spec, [self.parent.full_action_spec])
        return observation_spec

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Return the tensordict as it is: there is nothing to add to stored observations."""
        return tensordict

    def _require(self, tensordict: TensorDictBase, *keys: NestedKey) -> list[Tensor]:
        """Entries of the tensordict, or an error that names those that are missing and those that there are."""
        values: list[Any] = [tensordict.get(key, None) for key in keys]
        missing = [key for key, value in zip(keys, values, strict=True) if value is None]
        if missing:
            present = sorted(str(key) for key in tensordict.keys(True, True))
            raise KeyError(f"{type(self).__name__} needs {missing}; the tensordict holds {present}.{self._hint}")
        return values

    # -- masks --------------------------------------------------------------------------------------------------------

    @staticmethod
    def _stepping(tensordict: TensorDictBase) -> Tensor | None:
        """Which environments step, ``(*B,)``; None stands for all of them."""
        step = tensordict.get("_step", None)
        return None if step is None else step.reshape(tensordict.batch_size)

    def _reset_mask(self, tensordict: TensorDictBase, key: NestedKey) -> Tensor | None:
        """The reset signal for ``key``: that of its own nest, else the root's; None stands for all environments."""
        key = unravel_key(key)
        prefix = key[:-1] if isinstance(key, tuple) else ()
        while True:
            mask = tensordict.get((*prefix, "_reset"), None)
            if mask is not None:
                return mask.squeeze(-1) if mask.ndim > tensordict.ndim + len(prefix) else mask
            if not prefix:
                return None
            prefix = prefix[:-1]

    # -- state --------------------------------------------------------------------------------------------------------

    def _stash(self, tensordict: TensorDictBase, key: NestedKey, value: Tensor) -> None:
        """Keep a value of ``_inv_call`` for ``_step``."""
        if self.parent is not None:
            tensordict.set(_private(key), value)

    def _unstash(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase, key: NestedKey) -> None:
        """Write a kept value under next; environments that do not step keep the old one."""
        value = tensordict.get(_private(key))
        next_tensordict.set(key, _merged(self._stepping(tensordict), value, tensordict, key))

    def _zeros(self, specs: dict[NestedKey, TensorSpec], like: TensorDictBase) -> Entries:
        """Zeros of specs, with the leading dimensions that a tensordict of an environment without a lock has."""
        leading = like.shape[: like.ndim - len(self.parent.batch_size)]
        return {key: spec.zero(leading) for key, spec in specs.items()}

    def _restart(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase, key: NestedKey, initial: Tensor
    ) -> None:
        """Write the initial value where an environment resets; the others keep theirs."""
        tensordict_reset.set(key, _merged(self._reset_mask(tensordict, key), initial, tensordict, key))


class ActionTransform(StatefulTransform):
    """A transform of the action on its way to the environment (``inv``); observations pass through.

    ``inv`` needs no environment. A replay buffer applies it in ``extend``, so it stores the action that was executed.

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


class ObserverTransform(StatefulTransform):
    r"""A transform that adds observations and leaves the action alone.

    Its law is three functions of the readings ``r``, the entries ``in_keys``: the state at the start of an episode, the
    state after one more step, and further observations made from both.

    .. math::
        s_0 = \mathrm{begin}(r_0), \qquad s_{t+1} = \mathrm{update}(s_t, r_{t+1}), \qquad
        o_t = \mathrm{outputs}(s_t, r_t)

    A subclass defines those of ``_begin``, ``_update`` and ``_outputs`` that its law has, and the specs of state and
    outputs. This class handles masks, missing entries and resets. An observer without state works on stored data too.

    Args:
        in_keys: the readings; the first one gives dtype and device of all that is written.
        out_keys: the further observations.
    """

    #: Keys of the state, those of ``_state_specs``.
    state_keys: tuple[str, ...] = ()

    def __init__(self, in_keys: list[NestedKey], out_keys: list[NestedKey]) -> None:
        super().__init__(in_keys=in_keys, out_keys=out_keys)

    # -- the law ------------------------------------------------------------------------------------------------------

    def _begin(self, *readings: Tensor) -> Entries:
        """State at the start of an episode."""
        return {}

    def _update(self, state: Entries, *readings: Tensor) -> Entries:
        """State after one more step."""
        return {}

    def _outputs(self, tensordict: TensorDictBase, state: Entries, *readings: Tensor) -> Entries:
        """Further observations; ``tensordict`` is what they are written to."""
        return {}

    def _output_specs(self, batch: torch.Size, like: TensorSpec) -> dict[NestedKey, TensorSpec]:
        """Specs of the further observations."""
        return {}

    # -- its execution ------------------------------------------------------------------------------------------------

    def _read(self, tensordict: TensorDictBase) -> list[Tensor]:
        return self._require(tensordict, *self.in_keys)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        readings, state = self._read(next_tensordict), {}
        if self.state_keys:
            old = {key: tensordict.get(key, None) for key in self.state_keys}
            if [key for key, value in old.items() if value is None]:
                old = self._begin(*self._read(tensordict))
            state, stepping = self._update(old, *readings), self._stepping(tensordict)
            if stepping is not None:
                state = {key: _merged(stepping, value, old, key) for key, value in state.items()}
        return self._write(next_tensordict, state, readings)

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        readings = self._read(tensordict_reset)
        for key, value in self._begin(*readings).items():
            self._restart(tensordict, tensordict_reset, key, value)
        state = {key: tensordict_reset.get(key) for key in self.state_keys}
        return self._write(tensordict_reset, state, readings)

    def _write(self, tensordict: TensorDictBase, state: Entries, readings: list[Tensor]) -> TensorDictBase:
        for entries in (state, self._outputs(tensordict, state, *readings)):
            for key, value in entries.items():
                tensordict.set(key, value)
        return tensordict

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Add the observations to stored data where they need no state; else return the tensordict as it is."""
        return tensordict if self.state_keys else self._write(tensordict, {}, self._read(tensordict))

    def _like(self) -> TensorSpec:
        return self.parent.full_observation_spec[self.in_keys[0]]

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Declare state and further observations."""
        observation_spec = super().transform_observation_spec(observation_spec)
        for key, spec in self._output_specs(self.parent.batch_size, self._like()).items():
            set_leaf(observation_spec, key, spec)
        return observation_spec


def _private(key: NestedKey) -> str:
    return "_" + "/".join(key) if isinstance(key, tuple) else f"_{key}"


def _merged(rows: Tensor | None, new: Tensor, old: TensorDictBase | Entries, key: NestedKey) -> Tensor:
    """``new`` in the environments of the mask ``rows`` ``(*B,)``, what ``old`` has under ``key`` in the others."""
    value = None if rows is None else old.get(key, None)
    return new if rows is None or value is None else torch.where(expand_as_right(rows, new), new, value)
