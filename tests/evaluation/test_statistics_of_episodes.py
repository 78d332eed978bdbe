from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from ppt_rl.evaluation.columns import Column
from ppt_rl.evaluation.statistics import interval, summarise


def test_the_interval_of_a_rate_is_wilsons():
    values = np.array([1.0] * 95 + [0.0] * 5)
    n, p, z = 100, 0.95, stats.norm.ppf(0.975)
    centre = (p + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    assert interval(values, is_rate=True) == pytest.approx((centre - half, centre + half))


def test_the_interval_of_a_mean_covers_it_in_95_percent_of_samples():
    generator = np.random.default_rng(0)
    samples = generator.normal(3.0, 2.0, size=(4000, 12))
    covered = [low <= 3.0 <= high for low, high in (interval(sample, is_rate=False) for sample in samples)]
    assert np.mean(covered) == pytest.approx(0.95, abs=0.015)


def test_intervals_of_ratios_stay_within_zero_and_one():
    rows = {"overload_ratio": np.array([0.0] * 9 + [1.0]), "max_power": np.array([0.0, 9.0])}
    summary = summarise(rows, {"overload_ratio": Column("0-1"), "max_power": Column("W")})
    assert summary["overload_ratio"]["ci95"][0] == 0.0
    assert summary["max_power"]["ci95"][0] < 0.0
    assert summary["max_power"]["mean"] == 4.5


def test_one_episode_has_an_interval_of_no_width():
    assert interval(np.array([2.5]), is_rate=False) == (2.5, 2.5)
