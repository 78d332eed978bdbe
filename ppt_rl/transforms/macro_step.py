"""One policy step made of many control steps."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite, TensorSpec, Unbounded

from ppt_rl.functional.checks import require_finite
from ppt_rl.transforms.base import ActionTransform
from ppt_rl.transforms.chunk import ChunkMemory, carried, trace_key, where
from ppt_rl.transforms.specs import replace_leaf, set_leaf

__all__ = ["MacroStepTransform"]

_MEMORY = "_macro_step"
_SUMMED = "_keys_summed_by_macro_step"


class MacroStepTransform(ActionTransform):
    r"""Executes a chunk of actions, ``(*B, N, A)``, as one step of the outer environment.

    Transforms appended before it run at control rate, those appended after it once per chunk. Unlike torchrl's
    ``MultiAction`` it aggregates rewards, keeps all shapes uniform, and freezes environments that end inside the chunk.

    * Rewards, ``cost`` and the entries under ``reward_terms`` are summed: ``sum_k discount^k r_k``.
    * The other entries are those of the last control step that an environment executed.
    * ``control_steps`` ``(*B, 1)`` counts the control steps that an environment executed: for the discount of a
      semi-Markov process (``GAE.set_keys(steps_to_next_obs=("next", "control_steps"))``) and for counting frames.
    * ``trace_keys`` are recorded at every control step under ``("trace", key)``, ``(*B, N, ...)``, zero after the end.

    With ``interrupt_key``, an environment where that observation is True ends its chunk early. It then waits, without
    stepping, for the others, and continues from there at its next policy step. If every environment ends before the
    chunk does, the base environment is stepped once more and its answer discarded. If all wait and no episode is over,
    those that were interrupted last execute one more control step.

    Args:
        num_steps: N; None leaves it to the transform that makes the chunk.
        discount: discount of rewards from one control step to the next [-].
        trace_keys: entries under next to record.
        interrupt_key: observation ``(*B, 1)`` bool that ends a chunk early, such as ``new_wall``; the environment must
            honour a ``_step`` mask.
        action_key: the action: a chunk outside, its steps towards the environment.

    Raises:
        ValueError: if the chunk is empty, has another length than ``num_steps``, or is not finite.
        RuntimeError: if used without an environment.
    """

    macro_step = True

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
        if self.parent is None:
            raise RuntimeError("MacroStepTransform steps an environment and has none; append it to a TransformedEnv.")
        steps = self._checked_chunk(tensordict).unbind(tensordict.ndim)
        memory = ChunkMemory(tensordict, len(steps), self.discount, self._sum_keys(), self.trace_keys)
        memory.alive = self._allowed(tensordict)
        current, last, spare = self._all_but_last(tensordict, steps, memory)
        if current is not tensordict:
            tensordict.update(current)
        tensordict.set(self.action_key, last)
        if spare is not None:
            tensordict.set("_step", spare)
            memory.alive = torch.zeros_like(spare)
        elif memory.alive is not None and bool(memory.alive.any()):
            tensordict.set("_step", memory.alive)
        else:
            tensordict.pop("_step", None)
        return tensordict.set_non_tensor(_MEMORY, memory)

    def _all_but_last(
        self, tensordict: TensorDictBase, steps: Sequence[Tensor], memory: ChunkMemory
    ) -> tuple[TensorDictBase, Tensor, Tensor | None]:
        """Execute a chunk up to its last control step, which the outer environment executes itself.

        Returns:
            Root and action of that last control step, and a mask of environments that have to execute it for nothing,
            so that those that wait need not.
        """
        parent, current = self.parent, tensordict
        state_keys = parent.state_keys
        for number, action in enumerate(steps[:-1], start=1):
            current.set(self.action_key, action)
            alive = memory.alive
            if alive is not None:
                current.set("_step", alive)
            following = parent._step(current)
            frozen = memory.freeze(following)
            memory.add(following)
            ended = self._ended(following).reshape(tensordict.batch_size)
            if bool(ended.any()):
                memory.alive = ~ended if alive is None else alive & ~ended
                if not bool(memory.alive.any()):
                    done = frozen.get("done").reshape(tensordict.batch_size)
                    if self.interrupt_key is None or bool(done.all()):
                        current = carried(current, following.copy(), state_keys)
                        break
                    # Some environment has to step: one whose episode is over, else those interrupted just now.
                    memory.alive = ended if alive is None else ended & alive
                    spare = done if bool(done.any()) else None
                    return carried(current, following.copy(), state_keys), steps[number], spare
            current = carried(current, following if memory.alive is None else following.copy(), state_keys)
        return current, steps[-1], None

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        memory: ChunkMemory = tensordict.get_non_tensor(_MEMORY)
        if memory.alive is not None and memory.frozen is not None:
            next_tensordict = where(memory.alive, next_tensordict, memory.frozen)
        memory.add(next_tensordict)
        memory.write(next_tensordict)
        return next_tensordict

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        for key, zero in self._zeros(self._outputs(), tensordict_reset).items():
            tensordict_reset.set(key, zero)
        return tensordict_reset

    def _ended(self, following: TensorDictBase) -> Tensor:
        """Environments whose chunk is over, ``(*B, 1)``."""
        done = following.get("done")
        return done if self.interrupt_key is None else done | following.get(self.interrupt_key)

    def _allowed(self, tensordict: TensorDictBase) -> Tensor | None:
        """Environments that the caller lets step, ``(*B,)``; None stands for all of them."""
        mask = self._stepping(tensordict)
        return None if mask is None or bool(mask.all()) else mask

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
        """Entries that are summed; stored on the parent, which is made anew whenever the chain changes."""
        parent = self.parent
        keys = parent.__dict__.get(_SUMMED)
        if keys is None:
            observed = parent.full_observation_spec
            terms = observed.get("reward_terms", None)
            names: list[NestedKey] = [] if terms is None else [("reward_terms", name) for name in terms.keys()]
            names += ["cost"] if "cost" in observed.keys() else []
            keys = parent.__dict__[_SUMMED] = [*parent.reward_keys, *names]
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
            outputs[trace_key(key)] = Unbounded(shape=shape, dtype=spec.dtype, device=device)
        return outputs

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Declare ``control_steps`` and the traces."""
        for key, spec in self._outputs().items():
            set_leaf(observation_spec, key, spec)
        return observation_spec

    def transform_action_spec(self, action_spec: Composite) -> Composite:
        """Outside, the action is a chunk, with a dimension of control steps after the batch."""
        like = action_spec[self.action_key]
        ndim = len(self.parent.batch_size)
        length = -1 if self.num_steps is None else self.num_steps
        spec = like.unsqueeze(ndim).expand(*like.shape[:ndim], length, *like.shape[ndim:])
        return replace_leaf(action_spec, self.action_key, spec, type(self).__name__)
