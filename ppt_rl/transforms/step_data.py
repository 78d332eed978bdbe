"""Entries of a control step inside a macro step, where nobody but the library reads or writes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torchrl.envs import Compose, EnvBase, Transform, TransformedEnv

from ppt_rl.transforms.chain import attribute, transforms_of

__all__ = ["PlainStep", "StepData"]

#: Prefix of the library's modules.
_PACKAGE = f"{__name__.partition('.')[0]}."


class StepData(dict[str, Any]):
    """The part of a TensorDict's interface that the transforms of this library use, without its checks.

    A TensorDict checks type, batch size and device of every entry that is written. From one control step of a macro
    step to the next, an environment of this library and the library's transforms hand each other entries that they have
    made themselves, so no check is needed; with one environment the checks take a sixth of a control step. A nest is a
    ``StepData`` too.

    Args:
        entries: by name, those of a nest in a mapping of their own.
        batch_size: leading dimensions of every entry.
        device: of every entry.
    """

    __slots__ = ("batch_size", "device")

    def __init__(self, entries: Mapping[str, Any], batch_size: torch.Size, device: torch.device | None = None) -> None:
        super().__init__(entries)
        self.batch_size, self.device = batch_size, device
        for name, value in entries.items():
            if isinstance(value, Mapping):
                super().__setitem__(name, StepData(value, batch_size, device))

    @classmethod
    def of(cls, tensordict: TensorDictBase) -> StepData:
        """The entries of a TensorDict.

        Args:
            tensordict: it is not changed.

        Returns:
            The same entries.
        """
        nests = {name: cls.of(value) for name, value in tensordict.items() if isinstance(value, TensorDictBase)}
        return cls(dict(tensordict.items()) | nests, tensordict.batch_size, tensordict.device)

    @property
    def shape(self) -> torch.Size:
        """The batch size, as a TensorDict calls it too."""
        return self.batch_size

    @property
    def ndim(self) -> int:
        """Number of leading dimensions."""
        return len(self.batch_size)

    def get(self, key: NestedKey, default: Any = None) -> Any:
        """An entry.

        Args:
            key: of the entry.
            default: what stands for a missing one.

        Returns:
            The entry.
        """
        if isinstance(key, str):
            return super().get(key, default)
        nest: Any = self
        for name in key:
            nest = nest.get(name) if isinstance(nest, StepData) else None
            if nest is None:
                return default
        return nest

    def set(self, key: NestedKey, value: Any) -> StepData:
        """Write an entry, and make the nest that it lies in where there is none.

        Args:
            key: of the entry.
            value: the entry.

        Returns:
            This object.
        """
        if isinstance(key, str):
            self[key] = value
            return self
        nest = self
        for name in key[:-1]:
            nest = nest.setdefault(name, self.empty())
        nest[key[-1]] = value
        return self

    def empty(self) -> StepData:
        """The same without entries."""
        return StepData({}, self.batch_size, self.device)

    def copy(self) -> StepData:
        """The same entries, to which others can be added."""
        return StepData(self, self.batch_size, self.device)

    def keys(self, include_nested: bool = False, leaves_only: bool = False) -> Any:
        """The keys.

        Args:
            include_nested: whether those of entries in nests too.
            leaves_only: whether to leave out the nests themselves.

        Returns:
            An iterable of them.
        """
        return self._nested_keys(leaves_only) if include_nested else super().keys()

    def _nested_keys(self, leaves_only: bool) -> Iterator[NestedKey]:
        for name, value in self.items():
            if not isinstance(value, StepData):
                yield name
                continue
            if not leaves_only:
                yield name
            for key in value.keys(True, leaves_only):
                yield (name, key) if isinstance(key, str) else (name, *key)


@dataclass(frozen=True)
class PlainStep:
    """One step of an environment with plain entries.

    Attributes:
        base: the base environment.
        transforms: its transforms, outwards.
    """

    base: EnvBase
    transforms: tuple[Transform, ...]

    @classmethod
    def of(cls, env: EnvBase) -> PlainStep | None:
        """The step of an environment, where plain entries are enough for it.

        That holds where the base environment's ``can_step_plainly`` is True and every transform is the library's own:
        one from elsewhere may use all that a TensorDict can do. A macro step asks once, at its first chunk, so a
        ``_step`` that is replaced on the environment after that is not noticed.

        Args:
            env: any environment.

        Returns:
            The step; None where it needs a TensorDict.
        """
        layer = env
        while isinstance(layer, TransformedEnv):
            if type(layer)._step is not TransformedEnv._step or "_step" in vars(layer):
                return None
            if isinstance(layer.transform, Compose) and type(layer.transform) is not Compose:
                return None
            layer = layer.base_env
        transforms = tuple(transforms_of(env))
        ours = all(type(transform).__module__.startswith(_PACKAGE) for transform in transforms)
        return cls(layer, transforms) if ours and attribute(layer, "can_step_plainly") else None

    def __call__(self, root: StepData) -> StepData:
        """Make the step, as ``env._step`` makes it.

        Args:
            root: of the step; it is changed.

        Returns:
            What follows.
        """
        for transform in reversed(self.transforms):
            root = transform._inv_call(root)
        following = StepData(self.base.plain_step(root), root.batch_size, root.device)
        for transform in self.transforms:
            following = transform._step(root, following)
        return following
