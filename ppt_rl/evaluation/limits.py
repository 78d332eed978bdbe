"""Limits of force on a person, from ISO/TS 15066."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["LIMITS", "TRANSIENT_FACTOR", "shares_above"]

#: Largest quasi-static force on parts of the body [N].
LIMITS = {"face": 65.0, "hand": 140.0, "chest": 140.0, "abdomen": 110.0}
#: A transient contact may have so many times the force of a quasi-static one; the standard allows none on the face,
#: whose doubled limit stands here for comparison only.
TRANSIENT_FACTOR = 2.0


def shares_above(*, static: NDArray[np.float64], peak: NDArray[np.float64]) -> dict[str, dict[str, float]]:
    """Shares of the episodes above the limits.

    Args:
        static: ``(E,)`` static force of each episode [N].
        peak: ``(E,)`` peak force of each episode [N].

    Returns:
        By part of the body: ``quasi_static``, the share of ``static`` above the limit, and ``transient``, the share of
        ``peak`` above the transient limit; zero where there is no episode.
    """
    if not len(static):
        return {body: {"quasi_static": 0.0, "transient": 0.0} for body in LIMITS}
    return {
        body: {
            "quasi_static": float((static > limit).mean()),
            "transient": float((peak > TRANSIENT_FACTOR * limit).mean()),
        }
        for body, limit in LIMITS.items()
    }
