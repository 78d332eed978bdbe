"""One policy step made of many control steps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey, unravel_key
from torch import Tensor
from torchrl.data import Composite, TensorSpec, Unbounded

from ppt_rl.functional.argument_checks import require_number, require_whole
from ppt_rl.functional.checks import is_readable, require_finite
from ppt_rl.transforms.base import ActionTransform, StatefulTransform
from ppt_rl.transforms.chain import base_of, step_inside, transforms_of
from ppt_rl.transforms.chunk import ChunkMemory, carried, trace_key, where
from ppt_rl.transforms.specs import nest_of, replace_leaf, set_leaf
from ppt_rl.transforms.step_data import PlainStep, StepData
from ppt_rl.transforms.workers import steps_whole_workers, whole_workers

__all__ = ["MacroStepTransform"]

_MEMORY = "_macro_step"
_SUMMED = "_keys_summed_by_macro_step"
_INSIDE = "_step_inside_macro_step"
#: Control steps between two looks at who has ended, where a look makes the host wait for a device.
_WINDOW = 16


class MacroStepTransform(ActionTransform):
    r"""Executes a chunk of actions, ``(*B, N, A)``, as one step of the outer environment.

    An action in a nest, such as that of several agents, keeps the shape of its nest: ``(*B, agents, N, A)``.

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

    On a GPU the host does not wait for every control step to see who has ended. It looks once in 16 control steps;
    until then those that have ended are left out by a ``_step`` mask, which may then select none.

    Over ``SerialEnv`` or ``ParallelEnv`` it works too; where a worker holds several environments, which only step
    together, those that have ended move on unseen until the others have. Inside the workers it saves that, and most of
    the communication.

    Args:
        num_steps: N; None leaves it to the transform that makes the chunk.
        discount: discount of rewards from one control step to the next [-].
        trace_keys: entries under next to record, which transforms before the macro step write at every control step.
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
        if isinstance(trace_keys, str):
            raise ValueError(f"trace_keys is {trace_keys!r}; expected a list of keys, such as [{trace_keys!r}].")
        self.num_steps = None if num_steps is None else require_whole("num_steps", num_steps)
        self.discount = require_number("discount", discount, "a number in (0, 1]")
        if not 0.0 < self.discount <= 1.0:
            raise ValueError(f"discount is {discount}; expected a number in (0, 1].")
        self.trace_keys = list(trace_keys)
        self.interrupt_key = interrupt_key

    # -- the chunk ----------------------------------------------------------------------------------------------------

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        if self.parent is None:
            raise RuntimeError("MacroStepTransform steps an environment and has none; append it to a TransformedEnv.")
        chunk = self._checked_chunk(tensordict)
        steps, window = chunk.unbind(nest_of(tensordict, self.action_key).ndim), 1 if is_readable(chunk) else _WINDOW
        memory = ChunkMemory(tensordict, len(steps), self.discount, self._sum_keys(), self.trace_keys, window)
        memory.alive = self._allowed(tensordict)
        current, last, spare = self._all_but_last(tensordict, steps, memory)
        if current is not tensordict:
            tensordict.update(current)
        tensordict.set(self.action_key, last)
        if spare is not None:
            tensordict.set("_step", spare)
            memory.alive = torch.zeros_like(spare)
        elif memory.alive is not None and bool(memory.alive.any()):
            tensordict.set("_step", whole_workers(self.parent, memory.alive))
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
        state_keys, inside = parent.state_keys, self._inside()
        if isinstance(inside, PlainStep) and len(steps) > 1:
            current = StepData.of(tensordict)
        for number, action in enumerate(steps[:-1], start=1):
            current.set(self.action_key, action)
            if memory.alive is not None:
                current.set("_step", whole_workers(parent, memory.alive))
            following = inside(current)
            memory.advance(following, self._ended(following))
            if (number % memory.window == 0 or number == len(steps) - 1) and memory.none_goes_on():
                assert memory.frozen is not None
                done, current = self._done(memory.frozen), carried(current, following.copy(), state_keys)
                if self.interrupt_key is None or bool(done.all()):
                    break
                # Some environment has to step: one whose episode is over, else those interrupted last.
                back, memory.alive = memory.last_to_end()
                return current, steps[number - back], done if bool(done.any()) else None
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
        self._check_place()
        for key, zero in self._zeros(self._outputs(), tensordict_reset).items():
            tensordict_reset.set(key, zero)
        return tensordict_reset

    # -- environments -------------------------------------------------------------------------------------------------

    def _done(self, following: TensorDictBase) -> Tensor:
        """Environments whose episode is over, ``(*B,)``; without a flag at the root, one done agent ends it for all."""
        done = following.get("done", None)
        if done is not None:
            return done.reshape(following.batch_size)
        nested = [key for key in self.parent.done_keys if isinstance(key, tuple) and key[-1] == "done"]
        return torch.stack([following.get(key).flatten(following.ndim).any(-1) for key in nested]).any(0)

    def _ended(self, following: TensorDictBase) -> Tensor:
        """Environments whose chunk is over, ``(*B,)``."""
        done = self._done(following)
        if self.interrupt_key is None:
            return done
        return done | following.get(self.interrupt_key).reshape(following.batch_size)

    def _allowed(self, tensordict: TensorDictBase) -> Tensor | None:
        """Environments that the caller lets step, ``(*B,)``; None stands for all of them."""
        mask = self._stepping(tensordict)
        if mask is None or bool(mask.all()):
            return None
        if not torch.equal(mask, whole_workers(self.parent, mask)):
            owner = type(base_of(self.parent)).__name__
            raise ValueError(
                f"the _step mask is {mask.tolist()}, but {owner} steps whole workers only. Put MacroStepTransform into "
                "the workers."
            )
        return mask

    def _checked_chunk(self, tensordict: TensorDictBase) -> Tensor:
        (chunk,) = self._require(tensordict, self.action_key)
        batch = nest_of(tensordict, self.action_key).shape
        length = chunk.shape[len(batch)] if chunk.ndim > len(batch) + 1 else 0
        if length == 0 or (self.num_steps is not None and length != self.num_steps):
            wanted = ", ".join(map(str, [*batch, "N" if self.num_steps is None else self.num_steps, "A"]))
            raise ValueError(
                f"MacroStepTransform({self.num_steps or ''}): action has shape {tuple(chunk.shape)}; expected a chunk "
                f"({wanted}) of at least one action. A ProMPTransform makes chunks of replan_steps actions."
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

    def _inside(self) -> Callable[[Any], Any]:
        """What makes a control step of the environment inside."""
        parent = self.parent
        step = parent.__dict__.get(_INSIDE)
        if step is None:
            # A transform from elsewhere may change the state in the root of a step.
            leave_state = all(isinstance(other, StatefulTransform) for other in transforms_of(parent))
            step = PlainStep.of(parent) or partial(step_inside, parent, takes_over=leave_state)
            parent.__dict__[_INSIDE] = step
        return step

    def _check_parent(self) -> None:
        """Refuse an environment that chunks of this action cannot be executed on."""
        if self.interrupt_key is not None and steps_whole_workers(self.parent):
            owner = type(base_of(self.parent)).__name__
            raise ValueError(
                f"interrupt_key is {self.interrupt_key!r}, but {owner} steps whole workers of "
                f"{self.parent.batch_size[1:].numel()} environments, of which none can wait. Put MacroStepTransform "
                "into the workers."
            )
        keys = list(self.parent.full_action_spec.keys(True, True))
        others = [key for key in keys if key != self.action_key]
        if len(others) not in (0, len(keys)):
            raise ValueError(f"MacroStepTransform makes chunks of {self.action_key!r} alone; expected no {others}.")

    def _check_place(self) -> None:
        super()._check_place()
        parent = self.parent
        available = [*parent.full_observation_spec.keys(True, True), *parent.full_done_spec.keys(True, True)]
        if "control_steps" in available:
            raise ValueError("the environment has a MacroStepTransform already; expected one. Leave the other out.")
        wanted = [*self.trace_keys, *([] if self.interrupt_key is None else [self.interrupt_key])]
        unknown = [key for key in wanted if unravel_key(key) not in available]
        if unknown:
            raise ValueError(  # torchrl hides a KeyError that comes up while it looks for a spec
                f"trace key or interrupt_key {unknown} is no observation of a control step; expected one of "
                f"{available}, which the transforms before the macro step write."
            )

    def _outputs(self) -> dict[NestedKey, TensorSpec]:
        self._check_parent()
        parent = self.parent
        batch, device = parent.batch_size, parent.device
        outputs: dict[NestedKey, TensorSpec] = {
            "control_steps": Unbounded(shape=(*batch, 1), dtype=torch.int64, device=device)
        }
        if self.trace_keys and self.num_steps is None:
            raise ValueError("trace_keys need num_steps, so that their shape is known; pass num_steps=N.")
        available = parent.full_observation_spec
        for key in self.trace_keys:
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
        """Outside, the action is a chunk, with a dimension of control steps after the batch of its nest."""
        like = action_spec[self.action_key]
        ndim = nest_of(action_spec, self.action_key).ndim
        length = -1 if self.num_steps is None else self.num_steps
        spec = like.unsqueeze(ndim).expand(*like.shape[:ndim], length, *like.shape[ndim:])
        return replace_leaf(action_spec, self.action_key, spec, type(self).__name__)
