"""Faults of the collision benchmark that lie in the chain: a reference that jumps, a wrench that is read wrong."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec

from ppt_rl.transforms.base import ActionTransform, Entries
from ppt_rl.transforms.observer import ObserverTransform
from ppt_rl.transforms.specs import real

__all__ = ["JumpingReferenceTransform", "WrongWrenchTransform"]

#: Where the last readings are kept.
_HISTORY = "wrench_history"


class JumpingReferenceTransform(ActionTransform):
    """Moves the position of the reference by what the environment's ``reference_offset()`` says [m].

    Args:
        action_key: the reference, ``(*B, 13)`` pose and twist.
    """

    _at_control_rate = True

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        (reference,) = self._require(tensordict, self.action_key)
        base: Any = self.parent.base_env
        moved = reference[..., :3] + base.reference_offset().to(reference)
        return tensordict.set(self.action_key, torch.cat([moved, reference[..., 3:]], -1))


class WrongWrenchTransform(ObserverTransform):
    """Replaces the measured wrench: delayed in episodes of the environment's kind 0, scaled in those of kind 1.

    Append it first, right after the environment.

    Args:
        delay: control steps by which it is late [-].
        scale: factor on it [-].
    """

    state_keys = (_HISTORY,)

    def __init__(self, delay: int, scale: float) -> None:
        super().__init__(in_keys=["wrench"], out_keys=["wrench"])
        self.delay, self.scale = delay, scale

    def _state_specs(self, batch: torch.Size, like: TensorSpec) -> dict[Any, TensorSpec]:
        return {_HISTORY: real(like, *batch, self.delay + 1, 6)}

    def _begin(self, *readings: Tensor) -> Entries:
        return {_HISTORY: readings[0].unsqueeze(-2).expand(*readings[0].shape[:-1], self.delay + 1, 6)}

    def _update(self, state: Entries, *readings: Tensor) -> Entries:
        return {_HISTORY: torch.cat([state[_HISTORY][..., 1:, :], readings[0].unsqueeze(-2)], -2)}

    def _outputs(self, tensordict: TensorDictBase, state: Entries, *readings: Tensor) -> Entries:
        base: Any = self.parent.base_env
        kept = state[_HISTORY]
        late = (base.kind == 0).to(kept.device)
        return {"wrench": torch.where(late, kept[..., 0, :], self.scale * kept[..., -1, :])}
