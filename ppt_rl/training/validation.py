"""Validation: how well the policy does without exploring, measured from time to time while it learns."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

__all__ = ["VALIDATED", "Validation"]

#: Scalars that a validation logs.
VALIDATED = ("validation_success", "validation_max_power")


@dataclass(frozen=True)
class Validation:
    """When a policy is validated, and how.

    Attributes:
        measure: runs the deterministic policy and returns the scalars :data:`VALIDATED`. It changes no state of the
            training and draws from no random generator of it, so a run learns the same with and without validation.
        every: batches from one validation to the next; there is one before the first batch too.
    """

    measure: Callable[[], Mapping[str, float]]
    every: int

    def due(self, batches: int) -> bool:
        """Whether the policy is to be validated after so many batches."""
        return batches % self.every == 0
