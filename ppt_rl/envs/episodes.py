"""The state of a batch of episodes, as tensors that observations may share."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

__all__ = ["Episodes"]


class Episodes:
    """State of the episodes of a batch of environments; a subclass adds the tensors of a task.

    Args:
        num_envs: number of environments.
        dtype: precision of the tensors.
        device: where they are.
    """

    def __init__(self, num_envs: int, dtype: torch.dtype, device: torch.device | None = None) -> None:
        self.num_envs, self.dtype, self.device = num_envs, dtype, device
        self._allocate()

    def _allocate(self) -> None:
        """Create the tensors of the task."""

    def zeros(self, *shape: int) -> Tensor:
        """Zeros for every environment.

        Args:
            *shape: shape for one environment.

        Returns:
            ``(num_envs, *shape)`` zeros.
        """
        return torch.zeros(self.num_envs, *shape, dtype=self.dtype, device=self.device)

    def replace(self, rows: Tensor, **values: Any) -> None:
        """Replace tensors by copies that differ in some rows, so that earlier observations of them do not change.

        Args:
            rows: ``(R,)`` indices of the environments.
            **values: new rows by the name of the tensor, ``(R, *shape)`` tensors or arrays, or one number for all.
        """
        for name, value in values.items():
            tensor = getattr(self, name).clone()
            tensor[rows] = torch.as_tensor(value, dtype=tensor.dtype, device=tensor.device)
            setattr(self, name, tensor)
