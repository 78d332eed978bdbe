"""Statistics over episodes and over seeds: means with intervals, and tests of claimed orderings."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from ppt_rl.evaluation.columns import COLUMNS, POWER_AND_WORK, Column
from ppt_rl.functional.argument_checks import shown

__all__ = ["Claim", "distribution", "interval", "judge", "over_seeds", "summarise"]

Array = NDArray[Any]


def interval(values: Array, *, is_rate: bool) -> tuple[float, float]:
    """95 % confidence interval of a mean: Wilson's for a rate of successes, Student's otherwise.

    Args:
        values: one per episode.
        is_rate: whether the values are zeros and ones.

    Returns:
        Lower and upper end.

    Raises:
        ValueError: if there is no value, one is not finite, or one of a rate is neither zero nor one.
    """
    values = _values("values", values)
    if is_rate and not bool(np.isin(values, (0.0, 1.0)).all()):
        raise ValueError(f"values are {shown(values)}; expected zeros and ones for a rate. Pass is_rate=False.")
    count = len(values)
    if is_rate:
        result = stats.binomtest(round(float(values.sum())), count).proportion_ci(0.95, method="wilson")
        return float(result.low), float(result.high)
    if count < 2:
        return float(values.mean()), float(values.mean())
    half = float(stats.t.ppf(0.975, count - 1) * values.std(ddof=1) / math.sqrt(count))
    return float(values.mean()) - half, float(values.mean()) + half


def summarise(rows: Mapping[str, Array], columns: Mapping[str, Column] = COLUMNS) -> dict[str, dict[str, Any]]:
    """Mean and 95 % interval of each metric.

    Args:
        rows: what :func:`run_episodes` returned.
        columns: metrics to summarise.

    Returns:
        ``{name: {"mean": x, "ci95": [low, high]}}``; ratios stay within [0, 1].

    Raises:
        KeyError: if a metric is missing.
        ValueError: if a metric has no value, or one that is not finite.
    """
    _require("rows", rows, columns)
    summary: dict[str, dict[str, Any]] = {}
    for name, column in columns.items():
        low, high = interval(rows[name], is_rate=column.is_rate)
        if column.unit == "0-1":
            low, high = max(0.0, low), min(1.0, high)
        summary[name] = {"mean": float(rows[name].mean()), "ci95": [low, high]}
    return summary


def distribution(rows: Mapping[str, Array], names: Iterable[str] = POWER_AND_WORK) -> dict[str, dict[str, float]]:
    """Mean, 95th percentile and maximum over episodes of each quantity's magnitude.

    Args:
        rows: what :func:`run_episodes` returned for an audited environment.
        names: quantities to describe.

    Returns:
        ``{name: {"mean": x, "p95": x, "max": x}}``.

    Raises:
        KeyError: if a quantity is missing.
        ValueError: if a quantity has no value, or one that is not finite.
    """
    names = list(names)
    _require("rows", rows, names)
    sizes = {name: np.abs(_values(f"values of {name}", rows[name])) for name in names}
    return {
        name: {"mean": float(v.mean()), "p95": float(np.quantile(v, 0.95)), "max": float(v.max())}
        for name, v in sizes.items()
    }


def over_seeds(values: Sequence[float] | Array) -> dict[str, Any]:
    """Mean over seeds with its standard error and 95 % interval (Student's).

    Args:
        values: one per seed.

    Returns:
        ``mean``, ``se``, ``ci95`` (``[low, high]``), ``seeds``; with one seed, error and interval are None.

    Raises:
        ValueError: if there is no value, or one is not finite.
    """
    data = _values("values", values)
    count, mean = len(data), float(data.mean())
    summary: dict[str, Any] = {"mean": mean, "se": None, "ci95": None, "seeds": count}
    if count > 1:
        error = float(data.std(ddof=1)) / math.sqrt(count)
        half = float(stats.t.ppf(0.975, count - 1)) * error
        summary |= {"se": error, "ci95": [mean - half, mean + half]}
    return summary


def _values(name: str, values: Any) -> Array:
    """At least one finite number."""
    data = np.asarray(values, dtype=float)
    if not data.size:
        raise ValueError(f"{name} are empty; expected at least one number.")
    if not np.isfinite(data).all():
        raise ValueError(f"{name} are {shown(data)}; expected finite numbers. Look for an episode that diverged.")
    return data


def _require(what: str, table: Mapping[str, Any], names: Iterable[str]) -> None:
    missing = [name for name in names if name not in table]
    if missing:
        raise KeyError(f"{what} lack {missing}; expected them beside {list(table)}.")


@dataclass(frozen=True)
class Claim:
    """An ordering of two variants in one metric.

    Attributes:
        metric: its name.
        better: the variant claimed to be better.
        worse: the other one.
        higher_is_better: whether a higher value of the metric is better.
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

    Raises:
        KeyError: if a variant is missing.
        ValueError: if a variant has no value, or one that is not finite.
    """
    _require("values", values, (claim.better, claim.worse))
    first, second = (_values(f"values of {name!r}", values[name]) for name in (claim.better, claim.worse))
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
