from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy import stats

from ppt_rl.evaluation.resampling import iqm_interval, probability_of_improvement

scores = arrays.arrays(
    np.float64, st.tuples(st.integers(1, 6), st.integers(1, 3)), elements=st.integers(0, 8).map(lambda k: k / 8)
)


def test_the_interquartile_mean_is_that_of_the_middle_half_of_all_runs_and_groups():
    values = np.asarray([[0.0, 1.0], [2.0, 3.0], [4.0, 5.0], [6.0, 100.0]])
    assert iqm_interval(values)["iqm"] == pytest.approx(np.mean([2.0, 3.0, 4.0, 5.0]))


def test_the_interval_covers_the_true_value_as_often_as_it_says():
    rng = np.random.default_rng(0)
    covered = 0
    for trial in range(300):
        low, high = iqm_interval(rng.normal(size=(20, 2)), resamples=400, seed=trial)["iqm_ci95"]
        covered += low <= 0.0 <= high
    assert 0.90 <= covered / 300 <= 0.98  # the percentile bootstrap is a little short with 20 runs


def test_the_interval_is_that_of_scipy_where_there_is_one_group():
    values = np.random.default_rng(1).normal(size=(12, 1))
    ours = iqm_interval(values, resamples=20_000)["iqm_ci95"]
    theirs = stats.bootstrap(
        (values[:, 0],), lambda x, axis: stats.trim_mean(x, 0.25, axis=axis), n_resamples=20_000, method="percentile",
        rng=np.random.default_rng(2),
    ).confidence_interval  # fmt: skip
    np.testing.assert_allclose(ours, theirs, atol=0.03)


def test_resampling_keeps_the_groups_apart():
    """Without strata, a resample could hold one group more often than the other, and the mean would vary."""
    constant = np.tile([[0.0, 1.0]], (8, 1))
    assert iqm_interval(constant)["iqm_ci95"] == [0.5, 0.5]


@given(scores)
@settings(max_examples=50, deadline=None)
def test_an_interval_contains_its_mean_and_needs_two_runs(values):
    result = iqm_interval(values, resamples=200)
    assert (result["iqm_ci95"] is None) == (len(values) == 1)
    if result["iqm_ci95"] is not None:
        assert values.min() <= result["iqm_ci95"][0] <= result["iqm_ci95"][1] <= values.max()


@given(scores)
@settings(max_examples=50, deadline=None)
def test_the_probability_of_improvement_agrees_with_mann_and_whitney(values):
    other = np.random.default_rng(0).integers(0, 9, size=(4, values.shape[1])) / 8
    expected = np.mean(
        [
            stats.mannwhitneyu(values[:, g], other[:, g]).statistic / (len(values) * len(other))
            for g in range(values.shape[1])
        ]
    )
    assert probability_of_improvement(values, other, resamples=10)["probability"] == pytest.approx(expected)


@given(scores)
@settings(max_examples=50, deadline=None)
def test_improvements_in_both_directions_add_up_to_one(values):
    other = values[::-1] + 0.125
    there, back = (
        probability_of_improvement(*pair, resamples=10)["probability"] for pair in ((values, other), (other, values))
    )
    assert there + back == pytest.approx(1.0)


def test_a_variant_that_always_wins_improves_surely():
    result = probability_of_improvement([[0.9, 0.8]] * 5, [[0.1, 0.2]] * 5)
    assert result == {"probability": 1.0, "ci95": [1.0, 1.0]}


@pytest.mark.parametrize("bad", [[], [0.5], [[math.nan]], [[]], [[[0.5]]]])
def test_scores_that_are_no_finite_matrix_are_refused(bad):
    with pytest.raises(ValueError, match="a row for each run and a column for each group"):
        iqm_interval(bad)
    with pytest.raises(ValueError, match="a row for each run and a column for each group"):
        probability_of_improvement([[0.5]], bad)


def test_variants_in_other_groups_are_not_compared():
    with pytest.raises(ValueError, match="first has 2 groups and second has 1; expected the same groups"):
        probability_of_improvement([[0.5, 0.5]], [[0.5]])


def test_the_same_seed_gives_the_same_interval():
    values = np.random.default_rng(3).normal(size=(5, 2))
    assert iqm_interval(values, seed=4) == iqm_interval(values, seed=4)
    assert iqm_interval(values, seed=4) != iqm_interval(values, seed=5)
