"""A policy that decides less often than the controller acts."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite, TensorSpec

from ppt_rl.functional.argument_checks import require_number, require_whole
from ppt_rl.functional.checks import require_finite
from ppt_rl.transforms.base import ActionTransform
from ppt_rl.transforms.specs import real, replace_leaf

__all__ = ["HoldActionTransform"]


class HoldActionTransform(ActionTransform):
    r"""Turns an action ``a`` ``(*B, A)`` into a chunk ``(*B, N, A)`` that approaches it and then holds it.

    .. math:: u_n = a + s^n\,(u_0 - a), \qquad n = 1, \dots, N

    This is a first-order low-pass ``u_n = s u_{n-1} + (1 - s) a`` at every control step, in closed form; ``u_0`` is the
    last action executed before, zero at the start of an episode. With ``s = 0`` the action is held as it is. A policy
    that decides ten times a second explores far more with the same noise than one that decides a hundred times, because
    its noise does not average out within a tenth of a second.

    Append it after the :class:`MacroStepTransform` that executes the chunk. State and observation: ``last_action``
    ``(*B, A)``, the last one executed.

    Args:
        num_steps: N, control steps from one decision to the next.
        smoothing: s in [0, 1), share of the difference that remains after a control step [-].
        action_key: the action: one outside, a chunk towards the environment.

    Raises:
        ValueError: if a number is out of range, an action is not finite, or no macro step of N stands before it.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> hold = HoldActionTransform(3, smoothing=0.5)
        >>> hold.inv(TensorDict(action=torch.ones(1, 1), batch_size=[1]))["action"].flatten()
        tensor([0.5000, 0.7500, 0.8750])
    """

    def __init__(self, num_steps: int, *, smoothing: float = 0.0, action_key: NestedKey = "action") -> None:
        super().__init__(action_key)
        self.num_steps = require_whole("num_steps", num_steps)
        self.smoothing = require_number("smoothing", smoothing, "a number in [0, 1)")
        if not 0.0 <= self.smoothing < 1.0:
            raise ValueError(f"smoothing is {smoothing}; expected a number in [0, 1).")

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        (action,) = self._require(tensordict, self.action_key)
        require_finite("action (held)", action)
        last = self._known(tensordict, "last_action")
        last = torch.zeros_like(action) if last is None else last
        steps = torch.arange(1, self.num_steps + 1, dtype=action.dtype, device=action.device).unsqueeze(-1)
        chunk = action.unsqueeze(-2) + self.smoothing**steps * (last - action).unsqueeze(-2)
        self._stash(tensordict, "chunk", chunk)
        return tensordict.set(self.action_key, chunk)

    def _check_place(self) -> None:
        super()._check_place()
        shape, batch = tuple(self._like().shape), tuple(self.parent.batch_size)
        if len(shape) != len(batch) + 2 or shape[-2] not in (-1, self.num_steps):
            raise ValueError(
                f"the action {self.action_key!r} of the environment has shape {shape}; expected a chunk "
                f"{(*batch, self.num_steps, 'A')}. Append it after MacroStepTransform({self.num_steps})."
            )

    def _after_step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        tensordict.set("_last_action", self._executed(tensordict["_chunk"], next_tensordict.get("control_steps", None)))
        self._unstash(tensordict, next_tensordict, "last_action")
        return next_tensordict

    @staticmethod
    def _executed(chunk: Tensor, count: Tensor | None) -> Tensor:
        """The last action executed: a chunk may have been cut short."""
        if count is None:
            return chunk[..., -1, :]
        index = (count.clamp_min(1) - 1).unsqueeze(-1).expand(*count.shape, chunk.shape[-1])
        return chunk.take_along_dim(index, -2).squeeze(-2)

    def _after_reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        zeros = self._zeros(self._state_specs(self.parent.batch_size, self._like()), tensordict_reset)
        self._restart(tensordict, tensordict_reset, "last_action", zeros["last_action"])
        return tensordict_reset

    def _state_specs(self, batch: torch.Size, like: TensorSpec) -> dict[NestedKey, TensorSpec]:
        return {"last_action": real(like, *batch, like.shape[-1])}

    def transform_action_spec(self, action_spec: Composite) -> Composite:
        """Outside, the action is one, with the bounds of those in the chunk."""
        like = action_spec[self.action_key]
        single = like[..., 0, :].clone()
        return replace_leaf(action_spec, self.action_key, single, type(self).__name__)
