from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from ppt_rl.evaluation import curve_figures
from ppt_rl.evaluation.curve_figures import TrainingCurve, plot_curves

GENERATOR = np.random.default_rng(0)


def curve(length: int, validations: int = 0, *, seconds: float = 30.0) -> TrainingCurve:
    def table(steps: np.ndarray) -> dict[str, np.ndarray]:
        n = len(steps)
        return {"control_steps": steps, "success": GENERATOR.random(n), "max_power": 1 + GENERATOR.random(n)}

    batches = table(100.0 * np.arange(1, length + 1))
    return TrainingCurve(
        batches | {"seconds": seconds * np.arange(1, length + 1)}, table(200.0 * np.arange(validations))
    )


@pytest.fixture
def drawn(monkeypatch) -> list[Figure]:
    figures: list[Figure] = []
    monkeypatch.setattr(curve_figures, "save_figure", lambda figure, path: figures.append(figure))
    return figures


def lines(figure: Figure) -> list[tuple[np.ndarray, np.ndarray]]:
    return [line.get_data() for line in figure.axes[0].get_lines()]


def test_curves_of_unequal_length_and_of_one_seed_are_drawn(tmp_path: Path):
    plot_curves({"PPT": [curve(9, 4), curve(7, 3)], "S": [curve(5)]}, tmp_path / "a.png", p_max=2.0)
    picture = (tmp_path / "a.png").read_bytes()
    assert picture.startswith(b"\x89PNG")
    assert len(picture) > 20_000


def test_the_validated_policy_is_drawn_where_every_seed_was_validated(drawn):
    seeds = [curve(9, 4), curve(9, 4)]
    plot_curves({"PPT": seeds}, Path("never.png"), p_max=2.0)
    _, (steps, success) = lines(drawn[0])
    np.testing.assert_allclose(steps, seeds[0].validation["control_steps"] / 1e6)
    np.testing.assert_allclose(success, 100 * np.mean([seed.validation["success"] for seed in seeds], 0))
    plot_curves({"PPT": [curve(9, 4), curve(9, 0)]}, Path("never.png"), p_max=2.0)
    assert len(lines(drawn[1])) == 1


def test_the_time_of_a_validation_lies_between_those_of_the_batches_around_it(drawn):
    np.testing.assert_allclose(curve(9).minutes(np.asarray([0.0, 150.0, 900.0])), [0.0, 0.75, 4.5])
    plot_curves({"PPT": [curve(9, 4)]}, Path("never.png"), p_max=2.0)
    (*_, (minutes, _)) = (line.get_data() for line in drawn[0].axes[2].get_lines())
    np.testing.assert_allclose(minutes, [0.0, 1.0, 2.0, 3.0])
