"""A few numbers that change many: a policy that decides on combinations of an action's components."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite

from ppt_rl.functional.argument_checks import require_instance
from ppt_rl.functional.checks import require_finite, require_last_dim
from ppt_rl.transforms.base import ActionTransform
from ppt_rl.transforms.specs import real, replace_leaf

__all__ = ["ActionMapTransform"]


class ActionMapTransform(ActionTransform):
    r"""Turns an action ``a`` ``(*B, M)`` into one of ``N`` numbers, of which each is a fixed combination.

    .. math:: u = A\,a

    The noise of a policy that decides on ``M`` combinations goes where they lead. On the residual of a ProMP, whose
    weights follow each other in time, independent noise on every weight averages out along the trajectory; one number
    that moves all weights in proportion to their time changes the speed.

    Args:
        matrix: A, ``(N, M)``: what one unit of each number of the action adds to each number towards the environment.
        action_key: the action.

    Raises:
        ValueError: if the matrix has another shape or is not finite, it does not fit the environment's action, or an
            action is not finite.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> both = ActionMapTransform(torch.tensor([[1.0], [2.0]]))
        >>> both.inv(TensorDict(action=torch.ones(1, 1), batch_size=[1]))["action"].flatten()
        tensor([1., 2.])
    """

    matrix: Tensor

    def __init__(self, matrix: Tensor, *, action_key: NestedKey = "action") -> None:
        super().__init__(action_key)
        require_instance("matrix", matrix, Tensor)
        if matrix.ndim != 2 or not matrix.numel() or not bool(matrix.isfinite().all()):
            raise ValueError(f"matrix has shape {tuple(matrix.shape)}; expected finite numbers (N, M).")
        self.register_buffer("matrix", matrix.clone())

    def _check_place(self) -> None:
        super()._check_place()
        size, shape = self.matrix.shape[0], tuple(self._like().shape)
        if len(shape) != len(self.parent.batch_size) + 1 or shape[-1] != size:
            raise ValueError(
                f"matrix has {size} rows, but the action {self.action_key!r} of the environment has shape {shape}; "
                "expected a row for each of its numbers."
            )

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        (action,) = self._require(tensordict, self.action_key)
        require_last_dim("action (mapped)", action, self.matrix.shape[1])
        require_finite("action (mapped)", action)
        return tensordict.set(self.action_key, torch.nn.functional.linear(action, self.matrix.to(action)))

    def transform_action_spec(self, action_spec: Composite) -> Composite:
        """Outside, the action has M numbers."""
        like = action_spec[self.action_key]
        spec = real(like, *self.parent.batch_size, self.matrix.shape[1])
        return replace_leaf(action_spec, self.action_key, spec, type(self).__name__)
