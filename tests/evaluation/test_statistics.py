from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from ppt_rl.evaluation.statistics import Claim, judge, over_seeds

GENERATOR = np.random.default_rng(0)


def test_the_interval_over_seeds_is_students():
    summary = over_seeds([1.0, 2.0, 6.0])
    error = np.std([1.0, 2.0, 6.0], ddof=1) / np.sqrt(3)
    half = stats.t.ppf(0.975, 2) * error
    assert summary["mean"] == pytest.approx(3.0)
    assert summary["se"] == pytest.approx(error)
    assert summary["ci95"] == pytest.approx([3.0 - half, 3.0 + half])


def test_one_seed_has_no_interval():
    summary = over_seeds([0.5])
    assert summary["ci95"] is None
    assert summary["se"] is None


@pytest.mark.parametrize("higher_is_better", [True, False])
def test_a_clear_difference_holds_one_way_and_is_reversed_the_other(higher_is_better):
    high, low = [10.0, 10.1, 9.9], [1.0, 1.1, 0.9]
    values = {"A": high if higher_is_better else low, "B": low if higher_is_better else high}
    assert judge(Claim("m", "A", "B", higher_is_better), values)["verdict"] == "holds"
    assert judge(Claim("m", "B", "A", higher_is_better), values)["verdict"] == "reversed"


def test_a_difference_within_the_noise_is_not_resolved():
    values = {"A": [1.0, 2.0, 3.0], "B": [1.1, 2.1, 2.9]}
    assert judge(Claim("m", "A", "B", True), values)["verdict"] == "not resolved"


def test_equal_constants_are_not_resolved_and_different_ones_are():
    assert judge(Claim("m", "A", "B", True), {"A": [0.0, 0.0], "B": [0.0, 0.0]})["verdict"] == "not resolved"
    assert judge(Claim("m", "A", "B", True), {"A": [1.0, 1.0], "B": [0.0, 0.0]})["verdict"] == "holds"


def test_one_seed_resolves_nothing():
    assert judge(Claim("m", "A", "B", True), {"A": [9.0], "B": [0.0, 0.1]})["verdict"] == "not resolved"


def test_equal_means_are_told_apart_in_five_percent_of_samples_at_most():
    claim = Claim("m", "A", "B", True)
    samples = GENERATOR.normal(size=(1000, 2, 4))
    wrong = [judge(claim, {"A": a, "B": b})["verdict"] != "not resolved" for a, b in samples]
    assert np.mean(wrong) < 0.07


def test_spreads_are_compared_by_their_ratio():
    claim = Claim("m", "A", "B", False, spread=True)
    calm, wild = GENERATOR.normal(0, 0.01, 8), GENERATOR.normal(0, 1.0, 8)
    assert judge(claim, {"A": calm, "B": wild})["verdict"] == "holds"
    assert judge(claim, {"A": wild, "B": calm})["verdict"] == "reversed"
    equal = [
        judge(claim, {"A": a, "B": b})["verdict"] != "not resolved" for a, b in GENERATOR.normal(size=(1000, 2, 4))
    ]
    assert np.mean(equal) == pytest.approx(0.05, abs=0.025)
