"""What a macro step adds up, and what it carries from one control step to the next."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from tensordict import TensorDictBase, is_non_tensor
from tensordict.utils import NestedKey, expand_as_right
from torch import Tensor

from ppt_rl.functional.constants import constant
from ppt_rl.transforms.step_data import StepData

__all__ = ["ChunkMemory", "carried", "trace_key", "where"]


class _Executed(NamedTuple):
    """A control step that was executed: what it returned, who executed it, and whose chunk is over after it."""

    following: TensorDictBase
    alive: Tensor | None
    ended: Tensor


class ChunkMemory:
    """What the control steps of one chunk add up to. It exists for one step of the environment, in the tensordict.

    Whether an environment ended is looked at once in ``window`` control steps. In between, those that ended are left
    out of the next step by their mask, and what each step returned is held.

    Args:
        tensordict: root of the step, for batch size and device.
        length: number of control steps in the chunk.
        discount: discount of rewards from one control step to the next [-].
        sum_keys: entries that are summed.
        trace_keys: entries that are recorded.
        window: number of control steps after which the host looks at who has ended.
    """

    def __init__(
        self,
        tensordict: TensorDictBase,
        length: int,
        discount: float,
        sum_keys: Sequence[NestedKey],
        trace_keys: Sequence[NestedKey],
        window: int = 1,
    ) -> None:
        self.length, self.discount, self.window = length, discount, window
        self.total: dict[NestedKey, Tensor | None] = dict.fromkeys(sum_keys)
        self.trace: dict[NestedKey, list[Tensor]] = {key: [] for key in trace_keys}
        self.count = torch.zeros(tensordict.batch_size, dtype=torch.int64, device=tensordict.device)
        self.factor = 1.0
        #: Environments that execute the next control step, ``(*B,)``; None stands for all of them.
        self.alive: Tensor | None = None
        #: What every environment returned after its own last control step.
        self.frozen: TensorDictBase | None = None
        #: Control steps since the host last looked, and those until it did.
        self._held: list[_Executed] = []
        self._seen: list[_Executed] = []

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
        self.count = self.count + (constant(1, self.count) if self.alive is None else self.alive.to(torch.int64))
        self.factor *= self.discount

    def advance(self, following: TensorDictBase, ended: Tensor) -> None:
        """Add one control step, and hold what it returned.

        Args:
            following: what the environment returned.
            ended: ``(*B,)`` the environments whose chunk is over.
        """
        self.add(following)
        self._held.append(_Executed(following, self.alive, ended))
        if self.window > 1:  # the next step must leave them out before anybody has looked
            self.alive = ~ended if self.alive is None else self.alive & ~ended

    def none_goes_on(self) -> bool:
        """Look at who has ended, and take over what the environments returned in their own last control step.

        Returns:
            Whether the chunk is over for all environments.
        """
        held, self._held = self._held, []
        self._seen = held
        if self._nobody_ended(held):
            self.alive = held[0].alive
            self.frozen = self._taken_over(held[-1:] if self.alive is None else held)
            return False
        self.frozen = self._taken_over(held)
        last = held[-1]
        self.alive = ~last.ended if last.alive is None else last.alive & ~last.ended
        return not self.alive.any()

    def last_to_end(self) -> tuple[int, Tensor]:
        """Who ended last, after it was found that none goes on.

        Returns:
            How many control steps ago that was, and which environments they were, ``(*B,)``.
        """
        for back, step in enumerate(reversed(self._seen)):
            rows = step.ended if step.alive is None else step.ended & step.alive
            if rows.any():
                return back, rows
        raise RuntimeError("no environment ended; this is asked only after all of them did.")

    def _nobody_ended(self, held: Sequence[_Executed]) -> bool:
        if len(held) == 1:
            return not held[0].ended.any()
        return held[0].alive is None and bool(self.alive is None or self.alive.all())

    def _taken_over(self, held: Sequence[_Executed]) -> TensorDictBase | None:
        """What every environment returned after its own last control step, those of ``held`` included."""
        frozen = self.frozen
        for step in held:
            if step.alive is None or frozen is None:
                frozen = step.following
            else:
                frozen = where(step.alive, step.following, frozen)
        return frozen

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
        elif isinstance(value, TensorDictBase | StepData) and other is not None:
            value = where(rows, value, other)
        elif not is_non_tensor(value):
            continue
        merged.set(key, value)
    return merged


def _masked(value: Tensor, alive: Tensor | None) -> Tensor:
    return value if alive is None else value * expand_as_right(alive, value).to(value.dtype)
