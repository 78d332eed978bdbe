"""One policy step made of many control steps."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.utils import NestedKey, expand_as_right
from torch import Tensor
from torchrl.data import Composite, TensorSpec, Unbounded

from ppt_rl.functional.checks import require_finite
from ppt_rl.transforms.base import ActionTransform
from ppt_rl.transforms.specs import replace_leaf

__all__ = ["MacroStepTransform"]

_PRIVATE = "_macro_step"


class MacroStepTransform(ActionTransform):
    r"""Executes a chunk of actions, ``(*B, N, A)``, as one step of the environment outside.

    What is appended before it runs at control rate, what is appended after it once per chunk. Compared with torchrl's
    ``MultiAction`` it aggregates rewards, keeps every shape uniform, and freezes rows that end inside the chunk.

    * reward keys, ``cost``, and what stands under ``reward_terms``, are summed: ``sum_k discount^k r_k``;
    * the other entries are those of the last control step that a row executed;
    * ``control_steps`` ``(*B, 1)`` is how many a row executed, for the SMDP discount
      (``GAE.set_keys(steps_to_next_obs=("next", "control_steps"))``) and for counting frames;
    * ``trace_keys`` are recorded at every control step under ``("trace", key)``, ``(*B, N, ...)``; zero after the end.

    With ``interrupt_key``, a row where that observation is True ends its chunk early and waits, at rest in time, for
    the others; its next policy step goes on from there. When every row ends before the chunk does, the environment is
    stepped once more and its answer discarded; where all wait and no episode is over, those that were interrupted last
    execute one control step more.

    Args:
        num_steps: N; None leaves it to the transform that makes the chunk.
        discount: of rewards within the chunk [-].
        trace_keys: entries under next to record.
        interrupt_key: observation ``(*B, 1)`` bool that ends a row's chunk early, such as ``new_wall``; the
            environment must honour a ``_step`` mask.
        action_key: the action: a chunk outside, its steps towards the environment.

    Raises:
        ValueError: if the chunk is empty, has another length than ``num_steps``, or is not finite.
        RuntimeError: if used without an environment.
    """

    def __init__(
        self,
        num_steps: int | None = None,
        *,
        discount: float = 1.0,
        trace_keys: Sequence[NestedKey] = (),
        interrupt_key: NestedKey | None = None,
        action_key: NestedKey = "action",
    ) -> None:
        super().__init__(action_key)
        if num_steps is not None and num_steps < 1:
            raise ValueError(f"num_steps is {num_steps}; expected at least 1, or None.")
        if not 0.0 < discount <= 1.0:
            raise ValueError(f"discount is {discount}; expected a number in (0, 1].")
        self.num_steps = num_steps
        self.discount = float(discount)
        self.trace_keys = list(trace_keys)
        self.interrupt_key = interrupt_key

    # -- the chunk ----------------------------------------------------------------------------------------------------

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        parent = self.parent
        if parent is None:
            raise RuntimeError("MacroStepTransform steps an environment and has none; append it to a TransformedEnv.")
        chunk = self._checked_chunk(tensordict)
        steps = chunk.unbind(tensordict.ndim)
        sum_keys, state_keys = self._sum_keys(), parent.state_keys
        alive = self._stepping(tensordict)  # None: every row
        frozen: TensorDictBase | None = None
        spare: Tensor | None = None  # rows that step for nothing, so that those that wait need not
        memory = _Memory(tensordict, sum_keys, self.trace_keys)
        current = tensordict
        last = steps[-1]
        for number, action in enumerate(steps[:-1], start=1):
            current.set(self.action_key, action)
            if alive is not None:
                current.set("_step", alive)
            following = parent._step(current)
            frozen = following if alive is None or frozen is None else _where(alive, following, frozen)
            memory.add(following, alive, self.discount)
            ended = self._ended(following).reshape(tensordict.batch_size)
            if bool(ended.any()):
                stepped, alive = alive, ~ended if alive is None else alive & ~ended
                if not bool(alive.any()):
                    done = frozen.get("done").reshape(tensordict.batch_size)
                    if self.interrupt_key is None or bool(done.all()):
                        break
                    # Some row has to step: one whose episode is over, else those that were interrupted just now.
                    alive = ended if stepped is None else ended & stepped
                    spare = done if bool(done.any()) else None
                    current, last = _carried(current, following.copy(), state_keys), steps[number]
                    break
            current = _carried(current, following if alive is None else following.copy(), state_keys)
        if current is not tensordict:
            tensordict.update(current)
        tensordict.set(self.action_key, last)
        if spare is not None:
            tensordict.set("_step", spare)
            alive = torch.zeros_like(spare)
        elif alive is not None and bool(alive.any()):
            tensordict.set("_step", alive)
        else:
            tensordict.pop("_step", None)
        if alive is not None:
            memory.alive, memory.frozen = alive, frozen
        memory.length = len(steps)
        tensordict.set_non_tensor(_PRIVATE, memory)
        return tensordict

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        memory: _Memory = tensordict.get_non_tensor(_PRIVATE)
        if memory.alive is not None and memory.frozen is not None:
            next_tensordict = _where(memory.alive, next_tensordict, memory.frozen)
        memory.add(next_tensordict, memory.alive, self.discount)
        for key, total in memory.total.items():
            next_tensordict.set(key, total)
        next_tensordict.set("control_steps", memory.count.unsqueeze(-1))
        for key, values in memory.trace.items():
            next_tensordict.set(("trace", key) if isinstance(key, str) else ("trace", *key), memory.stacked(values))
        return next_tensordict

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        for key, zero in self._zeros(self._outputs(), tensordict_reset).items():
            tensordict_reset.set(key, zero)
        return tensordict_reset

    def _ended(self, following: TensorDictBase) -> Tensor:
        """Rows whose chunk is over, ``(*B, 1)``."""
        done = following.get("done")
        return done if self.interrupt_key is None else done | following.get(self.interrupt_key)

    @staticmethod
    def _stepping(tensordict: TensorDictBase) -> Tensor | None:
        """Rows that the caller lets step; None means all of them."""
        mask = tensordict.get("_step", None)
        return None if mask is None or bool(mask.all()) else mask.reshape(tensordict.batch_size)

    def _checked_chunk(self, tensordict: TensorDictBase) -> Tensor:
        (chunk,) = self._require(tensordict, self.action_key)
        ndim = tensordict.ndim
        length = chunk.shape[ndim] if chunk.ndim > ndim + 1 else 0
        if length == 0 or (self.num_steps is not None and length != self.num_steps):
            wanted = "N" if self.num_steps is None else self.num_steps
            raise ValueError(
                f"action has shape {tuple(chunk.shape)}; expected a chunk ({', '.join(map(str, tensordict.shape))}, "
                f"{wanted}, A) of at least one action."
            )
        require_finite("action (chunk)", chunk)
        return chunk

    # -- specs --------------------------------------------------------------------------------------------------------

    def _sum_keys(self) -> list[NestedKey]:
        parent = self.parent
        owner, keys = self.__dict__.get("_summed", (None, []))
        if owner is not parent:  # a clone, or a chain that changed, has another parent
            terms = parent.full_observation_spec.get("reward_terms", None)
            names: list[NestedKey] = [] if terms is None else [("reward_terms", name) for name in terms.keys()]
            names += ["cost"] if "cost" in parent.full_observation_spec.keys() else []
            keys = [*parent.reward_keys, *names]
            self.__dict__["_summed"] = parent, keys
        return keys

    def _outputs(self) -> dict[NestedKey, TensorSpec]:
        parent = self.parent
        batch, device = parent.batch_size, parent.device
        outputs: dict[NestedKey, TensorSpec] = {
            "control_steps": Unbounded(shape=(*batch, 1), dtype=torch.int64, device=device)
        }
        if self.trace_keys and self.num_steps is None:
            raise ValueError("trace_keys need num_steps, so that their shape is known; pass num_steps=N.")
        available = parent.full_observation_spec
        for key in self.trace_keys:
            if key not in available.keys(True, True):
                raise KeyError(f"trace key {key!r} is no observation; there are {list(available.keys(True, True))}.")
            spec = available[key]
            shape = (*batch, self.num_steps, *spec.shape[len(batch) :])
            name = ("trace", key) if isinstance(key, str) else ("trace", *key)
            outputs[name] = Unbounded(shape=shape, dtype=spec.dtype, device=device)
        return outputs

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Declare ``control_steps`` and the traces."""
        for key, spec in self._outputs().items():
            if isinstance(key, tuple) and key[0] not in observation_spec.keys():
                observation_spec[key[0]] = Composite(shape=observation_spec.shape, device=observation_spec.device)
            observation_spec[key] = spec
        return observation_spec

    def transform_action_spec(self, action_spec: Composite) -> Composite:
        """The action outside is a chunk, with a dimension of steps after the batch."""
        like = action_spec[self.action_key]
        ndim = len(self.parent.batch_size)
        length = -1 if self.num_steps is None else self.num_steps
        spec = like.unsqueeze(ndim).expand(*like.shape[:ndim], length, *like.shape[ndim:])
        return replace_leaf(action_spec, self.action_key, spec, type(self).__name__)


class _Memory:
    """What one chunk adds up: it lives for the duration of one step, in the tensordict."""

    def __init__(self, tensordict: TensorDictBase, sum_keys: list[NestedKey], trace_keys: list[NestedKey]) -> None:
        self.total: dict[NestedKey, Tensor | None] = dict.fromkeys(sum_keys)
        self.trace: dict[NestedKey, list[Tensor]] = {key: [] for key in trace_keys}
        self.count = torch.zeros(tensordict.batch_size, dtype=torch.int64, device=tensordict.device)
        self.alive: Tensor | None = None
        self.frozen: TensorDictBase | None = None
        self.factor = 1.0
        self.length = 0

    def add(self, following: TensorDictBase, alive: Tensor | None, discount: float) -> None:
        """Add one control step in the rows that are alive."""
        for key, total in self.total.items():
            value = _masked(following.get(key), alive)
            value = value if self.factor == 1.0 else value * self.factor
            self.total[key] = value if total is None else total + value
        for key, values in self.trace.items():
            values.append(_masked(following.get(key), alive))
        self.count = self.count + (1 if alive is None else alive.to(torch.int64))
        self.factor *= discount

    def stacked(self, values: list[Tensor]) -> Tensor:
        """Recorded values along a step dimension, padded to the chunk's length."""
        values = values + [torch.zeros_like(values[0])] * (self.length - len(values))
        return torch.stack(values, self.count.ndim)


def _carried(current: TensorDictBase, following: TensorDictBase, state_keys: Sequence[NestedKey]) -> TensorDictBase:
    """Root of the next control step: what the last one returned, and the state that it did not return."""
    for key in state_keys:
        if following.get(key, None) is None:
            value = current.get(key, None)
            if value is not None:
                following.set(key, value)
    return following


def _masked(value: Tensor, alive: Tensor | None) -> Tensor:
    return value if alive is None else value * expand_as_right(alive, value).to(value.dtype)


def _where(alive: Tensor, new: TensorDictBase, old: TensorDictBase) -> TensorDict:
    """Rows of ``new`` where alive, of ``old`` elsewhere, for every entry that both have."""
    return new._fast_apply(
        lambda a, b: torch.where(expand_as_right(alive, a), a, b), old.select(*new.keys(True, True), strict=False)
    )
