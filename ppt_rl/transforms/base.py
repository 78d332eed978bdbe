"""What the transforms of this library share: state, memory, actions."""

from __future__ import annotations

from typing import Any
from uuid import uuid4

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey, expand_as_right, unravel_key
from torch import Tensor
from torchrl.data import Composite, TensorSpec
from torchrl.envs import Transform

from ppt_rl.transforms.chain import parent_of, transforms_of
from ppt_rl.transforms.memory import Memory, memory_of
from ppt_rl.transforms.specs import set_leaf

__all__ = ["ActionTransform", "Entries", "StatefulTransform", "merged"]

#: Entries of a tensordict by key.
Entries = dict[NestedKey, Any]

#: Where a transform's memory and the keys that it keeps are stored on its parent, which belongs to it alone.
_MEMORY = "_memory_of_transform"


class StatefulTransform(Transform):
    """A transform with a state that is read from the root of the tensordict and written under ``"next"``.

    The keys of the state are declared in ``full_state_spec`` and in the observation spec. A partial reset changes only
    the environments that reset, and an environment outside the ``_step`` mask keeps its state. State that is computed
    on the way in (``_inv_call``) waits for ``_step`` under a private root key, which never leaves the environment.

    In a simulator, the environment's side also remembers this state and the readings that the transform needs on the
    way in, as they were at the transform's own place in the chain (:mod:`ppt_rl.transforms.memory`). What it remembers
    goes before what the root says. So a later transform may normalise an observation in place, and a policy may write
    what it likes, without changing what a controller or a tank reads.

    A subclass says what happens in ``_after_step`` and ``_after_reset``, where torchrl has ``_step`` and ``_reset``.

    Args:
        **keys: ``in_keys``, ``out_keys``, ``in_keys_inv`` and ``out_keys_inv`` of :class:`torchrl.envs.Transform`.
    """

    #: Whether the transform makes one step of many control steps.
    macro_step = False
    #: Whether the transform must act at every control step.
    _at_control_rate = False
    #: Whether what is remembered are copies, which nobody can change in place.
    _keeps_copies = False
    #: What the error about a missing entry adds, such as who writes that entry.
    _hint = ""

    def __init__(self, **keys: Any) -> None:
        super().__init__(**keys)
        self._token = uuid4().hex

    @property
    def parent(self) -> Any:  # TransformedEnv, None outside of an environment
        """The environment with the transforms before this one."""
        return parent_of(self)

    @property
    def _readings(self) -> tuple[NestedKey, ...]:
        """Observations that the transform reads on the way in."""
        return ()

    def _state_specs(self, batch: torch.Size, like: TensorSpec) -> dict[NestedKey, TensorSpec]:
        """Specs of the state for an environment of this batch size; ``like`` has its dtype and device."""
        return {}

    def _like(self) -> TensorSpec:
        """A spec with the dtype and device of the state."""
        return next(iter(self.parent.full_action_spec.values(True, True)))

    def _check_place(self) -> None:
        """Refuse a place in the chain where the transform cannot do what it promises, before the first reset."""
        if self._at_control_rate and any(
            getattr(transform, "macro_step", False) for transform in transforms_of(self.parent)
        ):
            raise ValueError(
                f"{type(self).__name__} stands after a MacroStepTransform, where it would act once for a whole chunk; "
                "append it before the MacroStepTransform."
            )

    def transform_output_spec(self, output_spec: Composite) -> Composite:
        """Check the place in the chain, then transform the spec."""
        self._check_place()
        return super().transform_output_spec(output_spec)

    def transform_input_spec(self, input_spec: Composite) -> Composite:
        """Declare the state in ``full_state_spec``."""
        self._check_place()
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
        if any(value is None for value in values):
            missing = [key for key, value in zip(keys, values, strict=True) if value is None]
            present = sorted(str(key) for key in tensordict.keys(True, True))
            named = [name for name, value in vars(self).items() if name.endswith("_key") and value in missing]
            elsewhere = f" Pass {'=, '.join(named)}= where it has another name." if named else ""
            raise KeyError(
                f"{type(self).__name__} needs {missing}; the tensordict holds {present}.{elsewhere}{self._hint}"
            )
        return values

    # -- memory -------------------------------------------------------------------------------------------------------

    def _memory(self) -> Memory | None:
        """What the environment's side remembers for this transform, if it does."""
        parent = self.parent
        if parent is None:
            return None
        if _MEMORY not in parent.__dict__:
            keys = [*self._state_specs(parent.batch_size, self._like()), *self._readings]
            parent.__dict__[_MEMORY] = memory_of(parent, self._token, keys)
        return parent.__dict__[_MEMORY]

    def _remember(self, tensordict: TensorDictBase, resetting: TensorDictBase | None = None) -> None:
        """Keep state and readings; copies of them, if nobody else may change them in place.

        After a reset, given the root with its signals, environments that did not reset keep what they had: what a base
        environment returns for them may be anything.
        """
        memory = self._memory()
        if memory is None:
            return
        for key in memory.keys:
            value = tensordict.get(key, None)
            if value is not None and resetting is not None:
                rows = self._reset_mask(resetting, key)
                value = value if rows is None else merged(rows, value, memory.entries.get(key))
            memory.entries[key] = value.clone() if self._keeps_copies and value is not None else value

    def _remembered(self, tensordict: TensorDictBase, key: NestedKey) -> Tensor | None:
        """An entry as the environment's side remembers it, if it does."""
        memory = self._memory()
        if memory is None or tensordict.batch_size != memory.batch_size:
            return None
        return memory.entries.get(key)

    def _known(self, tensordict: TensorDictBase, key: NestedKey) -> Tensor | None:
        """An entry as the environment's side remembers it, else as the root has it."""
        value = self._remembered(tensordict, key)
        return tensordict.get(key, None) if value is None else value

    def _recall(self, tensordict: TensorDictBase, *keys: NestedKey) -> list[Tensor]:
        """As :meth:`_require`, for readings and state on the way in."""
        values = [self._known(tensordict, key) for key in keys]
        found = [value for value in values if value is not None]
        return found if len(found) == len(keys) else self._require(tensordict, *keys)

    # -- masks --------------------------------------------------------------------------------------------------------

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        next_tensordict = self._after_step(tensordict, next_tensordict)
        self._remember(next_tensordict)
        return next_tensordict

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        self._check_place()
        tensordict_reset = self._after_reset(tensordict, tensordict_reset)
        self._remember(tensordict_reset, resetting=tensordict)
        return tensordict_reset

    def _after_step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        """What the transform adds to what the environment returned after a step."""
        return next_tensordict

    def _after_reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        """What the transform adds to what the environment returned after a reset."""
        return tensordict_reset

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

    @staticmethod
    def _stashed(tensordict: TensorDictBase, key: NestedKey) -> Tensor:
        """A value that ``_inv_call`` kept."""
        return tensordict.get(_private(key))

    def _unstash(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase, key: NestedKey) -> None:
        """Write a kept value under next; environments that do not step keep the old one."""
        rows, value = self._stepping(tensordict), self._stashed(tensordict, key)
        next_tensordict.set(key, value if rows is None else merged(rows, value, self._known(tensordict, key)))

    def _zeros(self, specs: dict[NestedKey, TensorSpec], like: TensorDictBase) -> Entries:
        """Zeros of specs, with the leading dimensions that a tensordict of an environment without a lock has."""
        leading = like.shape[: like.ndim - len(self.parent.batch_size)]
        return {key: spec.zero(leading) for key, spec in specs.items()}

    def _restart(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase, key: NestedKey, initial: Tensor
    ) -> None:
        """Write the initial value where an environment resets; the others keep theirs."""
        rows = self._reset_mask(tensordict, key)
        tensordict_reset.set(key, initial if rows is None else merged(rows, initial, self._known(tensordict, key)))


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

    def _check_place(self) -> None:
        super()._check_place()
        keys = list(self.parent.full_action_spec.keys(True, True))
        if unravel_key(self.action_key) not in keys:
            raise KeyError(
                f"{type(self).__name__} acts on {self.action_key!r}; expected one of {keys}, the action keys there are."
            )

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict

    def _like(self) -> TensorSpec:
        return self.parent.full_action_spec[self.action_key]


def _private(key: NestedKey) -> str:
    return "_" + "/".join(key) if isinstance(key, tuple) else f"_{key}"


def merged(rows: Tensor, new: Tensor, old: Tensor | None) -> Tensor:
    """Take new values in some environments and keep the old ones in the others.

    Args:
        rows: ``(*B,)`` mask of the environments that take the new ones.
        new: ``(*B, ...)``.
        old: ``(*B, ...)``; None where there are none, and all are new.

    Returns:
        ``(*B, ...)``.
    """
    return new if old is None else torch.where(expand_as_right(rows, new), new, old)
