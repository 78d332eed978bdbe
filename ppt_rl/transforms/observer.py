"""Transforms that only observe."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite, TensorSpec

from ppt_rl.transforms.base import Entries, StatefulTransform, merged
from ppt_rl.transforms.specs import set_leaf

__all__ = ["ObserverTransform"]


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

    def _after_step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        readings, state = self._read(next_tensordict), {}
        if self.state_keys:
            old = {key: self._known(tensordict, key) for key in self.state_keys}
            if [key for key, value in old.items() if value is None]:
                old = self._begin(*self._read(tensordict))
            state, stepping = self._update(old, *readings), self._stepping(tensordict)
            if stepping is not None:
                state = {key: merged(stepping, value, old[key]) for key, value in state.items()}
        return self._write(next_tensordict, state, readings)

    def _after_reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
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
