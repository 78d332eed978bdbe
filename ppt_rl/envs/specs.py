"""Specs of batched observations."""

from __future__ import annotations

import torch
from torchrl.data import Binary, Composite, Unbounded

__all__ = ["SpecMaker"]


class SpecMaker:
    """Makes specs that share their batch size, precision and device.

    Args:
        batch_size: leading shape of every spec.
        dtype: precision of real numbers.
        device: device of every spec.
    """

    def __init__(self, batch_size: torch.Size, dtype: torch.dtype, device: torch.device) -> None:
        self.batch_size, self.dtype, self.device = batch_size, dtype, device

    def real(self, *shape: int) -> Unbounded:
        """Spec of unbounded real numbers.

        Args:
            *shape: shape after the batch.
        """
        return Unbounded(shape=(*self.batch_size, *shape), dtype=self.dtype, device=self.device)

    def flag(self, size: int = 1) -> Binary:
        """Spec of booleans.

        Args:
            size: how many for each environment.
        """
        return Binary(n=size, shape=(*self.batch_size, size), dtype=torch.bool, device=self.device)

    def nest(self, **specs: Unbounded | Binary | Composite) -> Composite:
        """Composite of specs.

        Args:
            **specs: the entries by name.
        """
        return Composite(specs, shape=self.batch_size, device=self.device)
