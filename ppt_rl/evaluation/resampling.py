"""Statistics over few runs: interquartile means with stratified bootstrap intervals, probability of improvement."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from ppt_rl.functional.argument_checks import require_whole, shown

__all__ = ["iqm_interval", "probability_of_improvement"]

Array = NDArray[np.float64]
Scores = Sequence[Sequence[float]] | Array
#: Share of the scores that an interquartile mean leaves out at each end.
_QUARTER = 0.25


def iqm_interval(scores: Scores, *, resamples: int = 2000, seed: int = 0) -> dict[str, Any]:
    r"""Interquartile mean over runs and groups, with its 95 % interval by stratified bootstrap.

    The scores of all runs in all groups are pooled; the mean is that of the middle half. A resample draws runs with
    replacement in each group on its own, so every group keeps its share. The interval lies between the percentiles
    2.5 and 97.5 of the resamples.

    Args:
        scores: ``(runs, groups)``, such as the success of each seed on each box.
        resamples: number of resamples.
        seed: seed of the resamples.

    Returns:
        ``iqm``, and ``iqm_ci95`` (``[low, high]``), which is None with one run.

    Raises:
        ValueError: if the scores are no finite matrix, or ``resamples`` is not a whole number of at least 1.

    Source:
        Agarwal et al., "Deep Reinforcement Learning at the Edge of the Statistical Precipice", NeurIPS 2021, section 4.
    """
    data = _matrix("scores", scores)
    result: dict[str, Any] = {"iqm": float(_iqm(data)), "iqm_ci95": None}
    if len(data) > 1:
        drawn = _resampled(data, np.random.default_rng(seed), require_whole("resamples", resamples, 1))
        result["iqm_ci95"] = _percentiles(_iqm(drawn))
    return result


def probability_of_improvement(
    first: Scores, second: Scores, *, resamples: int = 2000, seed: int = 0
) -> dict[str, Any]:
    r"""Probability that a run of one variant scores higher than a run of another, mean over the groups.

    .. math:: P(X > Y) = \frac1G \sum_g \frac1{N M} \sum_{i,j}
        \big([x_{ig} > y_{jg}] + \tfrac12 [x_{ig} = y_{jg}]\big)

    The interval is that of the stratified bootstrap of :func:`iqm_interval`, in which both variants are resampled.

    Args:
        first: ``(runs, groups)`` scores x of the variant that may be better.
        second: ``(runs, groups)`` scores y of the other one, in the same groups.
        resamples: number of resamples.
        seed: seed of the resamples.

    Returns:
        ``probability`` in [0, 1], and ``ci95`` (``[low, high]``), which is None if one of the variants has one run.

    Raises:
        ValueError: if the scores are no finite matrices with as many groups, or ``resamples`` is not a whole number of
            at least 1.

    Source:
        As for :func:`iqm_interval`; the statistic is that of Mann and Whitney.
    """
    x, y = _matrix("first", first), _matrix("second", second)
    if x.shape[1] != y.shape[1]:
        raise ValueError(f"first has {x.shape[1]} groups and second has {y.shape[1]}; expected the same groups.")
    result: dict[str, Any] = {"probability": float(_exceeds(x, y)), "ci95": None}
    if min(len(x), len(y)) > 1:
        rng, count = np.random.default_rng(seed), require_whole("resamples", resamples, 1)
        result["ci95"] = _percentiles(_exceeds(_resampled(x, rng, count), _resampled(y, rng, count)))
    return result


def _matrix(name: str, scores: Any) -> Array:
    data = np.asarray(scores, dtype=float)
    if data.ndim != 2 or not data.size or not np.isfinite(data).all():
        raise ValueError(
            f"{name} is {shown(scores)}; expected finite numbers, a row for each run and a column for each group."
        )
    return data


def _iqm(scores: Array) -> Array:
    """Interquartile mean over the last two dimensions."""
    return stats.trim_mean(scores.reshape(*scores.shape[:-2], -1), _QUARTER, axis=-1)


def _exceeds(first: Array, second: Array) -> Array:
    """Share of the pairs of runs in which the first scores higher, over groups; half of the ties."""
    difference = first[..., :, None, :] - second[..., None, :, :]
    return (0.5 * (1.0 + np.sign(difference))).mean((-3, -2, -1))


def _resampled(scores: Array, rng: np.random.Generator, count: int) -> Array:
    """``(count, runs, groups)``: runs drawn with replacement, in each group on its own."""
    rows = rng.integers(len(scores), size=(count, *scores.shape))
    return np.take_along_axis(scores[None], rows, axis=1)


def _percentiles(values: Array) -> list[float]:
    return [float(value) for value in np.percentile(values, (2.5, 97.5))]
