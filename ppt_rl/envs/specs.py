"""Specs of batched observations."""

from __future__ import annotations

import torch
from torchrl.data import Binary, Composite, Unbounded

__all__ = ["SpecMaker"]


class SpecMaker:
    """Makes specs of one batch size, precision and device.

    Args:
        batch_size: leading shape of every spec.
        dtype: of real numbers.
        device: of everything.
    """

    def __init__(self, batch_size: torch.Size, dtype: torch.dtype, device: torch.device) -> None:
        self.batch_size, self.dtype, self.device = batch_size, dtype, device

    def real(self, *shape: int) -> Unbounded:
        """Real numbers.

        Args:
            *shape: after the batch.
        """
        return Unbounded(shape=(*self.batch_size, *shape), dtype=self.dtype, device=self.device)

    def flag(self, size: int = 1) -> Binary:
        """Booleans.

        Args:
            size: how many.
        """
        return Binary(n=size, shape=(*self.batch_size, size), dtype=torch.bool, device=self.device)

    def nest(self, **specs: Unbounded | Binary | Composite) -> Composite:
        """A composite.

        Args:
            **specs: its entries.
        """
        return Composite(specs, shape=self.batch_size, device=self.device)
