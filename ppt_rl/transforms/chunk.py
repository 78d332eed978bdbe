"""What a macro step adds up, and what it carries from one control step to the next."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase, is_non_tensor
from tensordict.utils import NestedKey, expand_as_right
from torch import Tensor

__all__ = ["ChunkMemory", "carried", "trace_key", "where"]


class ChunkMemory:
    """What the control steps of one chunk add up to. It exists for one step of the environment, in the tensordict.

    Args:
        tensordict: root of the step, for batch size and device.
        length: number of control steps in the chunk.
        discount: discount of rewards from one control step to the next [-].
        sum_keys: entries that are summed.
        trace_keys: entries that are recorded.
    """

    def __init__(
        self,
        tensordict: TensorDictBase,
        length: int,
        discount: float,
        sum_keys: Sequence[NestedKey],
        trace_keys: Sequence[NestedKey],
    ) -> None:
        self.length, self.discount = length, discount
        self.total: dict[NestedKey, Tensor | None] = dict.fromkeys(sum_keys)
        self.trace: dict[NestedKey, list[Tensor]] = {key: [] for key in trace_keys}
        self.count = torch.zeros(tensordict.batch_size, dtype=torch.int64, device=tensordict.device)
        self.factor = 1.0
        #: Environments that execute the next control step, ``(*B,)``; None stands for all of them.
        self.alive: Tensor | None = None
        #: What every environment returned after its own last control step.
        self.frozen: TensorDictBase | None = None

    def add(self, following: TensorDictBase) -> None:
        """Add one control step of the environments that are alive.

        Args:
            following: what the environment returned.
        """
        for key, total in self.total.items():
            value = _masked(following.get(key), self.alive)
            value = value if self.factor == 1.0 else value * self.factor
            self.total[key] = value if total is None else total + value
        for key, values in self.trace.items():
            values.append(_masked(following.get(key), self.alive))
        self.count = self.count + (1 if self.alive is None else self.alive.to(torch.int64))
        self.factor *= self.discount

    def freeze(self, following: TensorDictBase) -> TensorDictBase:
        """Take over what the environments that are alive returned.

        Args:
            following: what the environment returned.

        Returns:
            What every environment returned after its own last control step.
        """
        if self.alive is None or self.frozen is None:
            self.frozen = following
        else:
            self.frozen = where(self.alive, following, self.frozen)
        return self.frozen

    def write(self, next_tensordict: TensorDictBase) -> None:
        """Write sums, number of control steps and traces, these padded with zeros to the length of the chunk.

        Args:
            next_tensordict: changed in place.
        """
        for key, total in self.total.items():
            next_tensordict.set(key, total)
        next_tensordict.set("control_steps", self.count.unsqueeze(-1))
        for key, values in self.trace.items():
            padded = values + [torch.zeros_like(values[0])] * (self.length - len(values))
            next_tensordict.set(trace_key(key), torch.stack(padded, self.count.ndim))


def trace_key(key: NestedKey) -> tuple[str, ...]:
    """Key of a recorded entry.

    Args:
        key: of the entry itself.

    Returns:
        The same under ``trace``.
    """
    return ("trace", key) if isinstance(key, str) else ("trace", *key)


def carried(current: TensorDictBase, following: TensorDictBase, state_keys: Sequence[NestedKey]) -> TensorDictBase:
    """Root of the next control step: what the last one returned, and the state that it did not return.

    Args:
        current: root of the last control step.
        following: what it returned; changed in place.
        state_keys: keys of the environment's state.

    Returns:
        ``following``.
    """
    for key in state_keys:
        if following.get(key, None) is None:
            value = current.get(key, None)
            if value is not None:
                following.set(key, value)
    return following


def where(rows: Tensor, new: TensorDictBase, old: TensorDictBase) -> TensorDictBase:
    """Entries of ``new`` in some environments, of ``old`` in the others.

    Args:
        rows: ``(*B,)`` mask of the environments that take ``new``.
        new: a tensordict.
        old: a tensordict.

    Returns:
        Every entry that both have. What is no tensor, such as a picture, has no rows and is that of ``new``.
    """
    merged = new.empty()
    for key, value in new.items():
        other = old.get(key, None)
        if isinstance(value, Tensor) and other is not None:
            value = torch.where(expand_as_right(rows, value), value, other)
        elif isinstance(value, TensorDictBase) and other is not None:
            value = where(rows, value, other)
        elif not is_non_tensor(value):
            continue
        merged.set(key, value)
    return merged


def _masked(value: Tensor, alive: Tensor | None) -> Tensor:
    return value if alive is None else value * expand_as_right(alive, value).to(value.dtype)
