"""The comparison of a policy that asks for its energy with fixed capacities."""

from __future__ import annotations

import json
from pathlib import Path

import energy_budget
import numpy as np
import pytest
import torch

from ppt_rl import Policy, load_policy
from ppt_rl.recipes.ppo_ppt_budget_push import RECIPE
from ppt_rl.transforms import EnergyBudgetTransform
from tests.recipes.test_ppt_budget_push import tiny


@pytest.fixture(scope="module")
def policy(tmp_path_factory: pytest.TempPathFactory) -> Policy:
    """A policy of two batches."""
    return load_policy(RECIPE.train(tiny(tmp_path_factory.mktemp("budget"), validate_every=0)))


@pytest.mark.parametrize("energy", [0.2, 0.9, 1.29])
def test_a_request_for_an_energy_is_granted_it(energy):
    budget = EnergyBudgetTransform(1.3, least_share=0.1, initial_share=0.7)
    request = torch.tensor(energy_budget.request_for(budget, energy), dtype=torch.float64)
    assert float(budget.granted(request)) == pytest.approx(energy, abs=1e-9)


def test_everyone_is_granted_the_same_where_that_is_asked_for_and_the_episodes_are_the_same(policy):
    options = energy_budget.Options(episodes=3, seeds=(7, 8))
    own, always = (energy_budget.episodes_of(policy, options, always=value) for value in (None, 0.5))
    assert len(own["success"]) == 12  # three episodes on each of two boxes, of each of two seeds
    assert np.array_equal(own["distance"], always["distance"])
    assert np.ptp(own["granted"]) > 0
    np.testing.assert_allclose(always["granted"], 0.5, rtol=1e-5)
    figures = energy_budget.figures_of(always)
    assert figures["correlation"] is None
    assert figures["most_of_granted"] <= 1 + 1e-5


def test_the_figures_follow_from_the_episodes():
    rows = {
        "success": np.array([1.0, 1, 0, 1, 0, 0]), "work": np.full(6, 0.3), "distance": np.arange(6.0),
        "granted": 0.5 + 0.1 * np.arange(6.0),
    }  # fmt: skip
    figures = energy_budget.figures_of(rows)
    assert figures["success"] == 0.5
    assert figures["granted"] == pytest.approx(0.75)
    assert figures["granted_by_third"] == pytest.approx([0.55, 0.75, 0.95])
    assert figures["success_by_third"] == pytest.approx([1.0, 0.5, 0.0])
    assert figures["correlation"] == pytest.approx(1.0)
    assert figures["most_of_granted"] == pytest.approx(0.6)


@pytest.mark.slow
def test_the_figures_are_written(policy, tmp_path):
    energy_budget.main(energy_budget.Options(policy=str(policy.source), episodes=3, seeds=(7,), report=tmp_path))
    actors = json.loads((tmp_path / "energy_budget.json").read_text())["actors"]
    mean = next(iter(actors.values()))["granted"]
    name = Path(policy.source).name
    assert list(actors) == [
        f"{name}, as it asks", f"{name}, always {mean:.2f} J", "ppt_push, 1.3 J", f"ppt_push, {mean:.2f} J",
        "lagrangian_push + tank, 1.3 J", f"lagrangian_push + tank, {mean:.2f} J",
    ]  # fmt: skip
