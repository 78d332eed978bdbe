"""Statistics over seeds: means with intervals, interquartile means, and which of a set of orderings hold."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

__all__ = ["Claim", "interquartile_mean", "judge", "over_seeds"]

Array = NDArray[np.float64]


def interquartile_mean(values: Sequence[float] | Array) -> float:
    """Mean of what is left when a quarter is cut off at either end.

    Args:
        values: at least one; with fewer than four nothing is cut off.

    Returns:
        The mean.
    """
    return float(stats.trim_mean(np.asarray(values, dtype=float), 0.25))


def over_seeds(values: Sequence[float] | Array) -> dict[str, Any]:
    """Mean over seeds with its standard error and 95 % interval (Student's).

    Args:
        values: one per seed.

    Returns:
        ``mean``, ``se``, ``ci95`` (``[low, high]``), ``iqm``, ``seeds``; with one seed, error and interval are None.
    """
    data = np.asarray(values, dtype=float)
    count, mean = len(data), float(data.mean())
    summary: dict[str, Any] = {"mean": mean, "se": None, "ci95": None, "iqm": interquartile_mean(data), "seeds": count}
    if count > 1:
        error = float(data.std(ddof=1)) / math.sqrt(count)
        half = float(stats.t.ppf(0.975, count - 1)) * error
        summary |= {"se": error, "ci95": [mean - half, mean + half]}
    return summary


@dataclass(frozen=True)
class Claim:
    """An ordering of two variants in one metric.

    Attributes:
        metric: its name.
        better: the variant that is said to be better.
        worse: the other one.
        higher_is_better: which way the metric points.
        spread: whether the claim is about the spread over seeds instead of the mean.
    """

    metric: str
    better: str
    worse: str
    higher_is_better: bool
    spread: bool = False


def judge(claim: Claim, values: Mapping[str, Sequence[float]]) -> dict[str, Any]:
    """Whether a claim holds: by Welch's interval of a difference of means, or by the F interval of a ratio of spreads.

    Args:
        claim: what is claimed.
        values: by variant, the metric's mean in each seed.

    Returns:
        ``verdict`` (``holds``, ``reversed``, ``not resolved``), ``better`` and ``worse``, the two figures, and ``ci95``
        of the difference better - worse (for a claim of spread, of the ratio of standard deviations); None with one
        seed.
    """
    first, second = (np.asarray(values[name], dtype=float) for name in (claim.better, claim.worse))
    if min(len(first), len(second)) < 2:
        return {"verdict": "not resolved", "better": first.mean(), "worse": second.mean(), "ci95": None}
    if claim.spread:
        return _judge_spread(first, second)
    low, high = _welch(first, second)
    sign = 1.0 if claim.higher_is_better else -1.0
    verdict = "not resolved" if low <= 0.0 <= high else "holds" if sign * low > 0 else "reversed"
    return {"verdict": verdict, "better": float(first.mean()), "worse": float(second.mean()), "ci95": [low, high]}


def _welch(first: Array, second: Array) -> tuple[float, float]:
    """95 % interval of the difference of two means."""
    difference = float(first.mean() - second.mean())
    if first.std() == 0.0 and second.std() == 0.0:
        return difference, difference
    interval = stats.ttest_ind(first, second, equal_var=False).confidence_interval(0.95)
    return float(interval.low), float(interval.high)


def _judge_spread(first: Array, second: Array) -> dict[str, Any]:
    a, b = float(first.std(ddof=1)), float(second.std(ddof=1))
    if a == 0.0 or b == 0.0:
        verdict = "not resolved" if a == b else "holds" if a < b else "reversed"
        return {"verdict": verdict, "better": a, "worse": b, "ci95": None}
    freedom = len(first) - 1, len(second) - 1
    ratio = (a / b) ** 2
    low, high = (math.sqrt(ratio / stats.f.ppf(q, *freedom)) for q in (0.975, 0.025))
    verdict = "holds" if high < 1.0 else "reversed" if low > 1.0 else "not resolved"
    return {"verdict": verdict, "better": a, "worse": b, "ci95": [low, high]}
