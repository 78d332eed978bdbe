from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from matplotlib.figure import Figure

from ppt_rl.evaluation.figures import one_legend, plot_calibration
from ppt_rl.evaluation.study_figures import (
    _marginal,
    plot_boxes,
    plot_filmstrip,
    plot_promp,
    plot_sweep,
    plot_tanks,
)
from ppt_rl.modules import ProMP

GENERATOR = np.random.default_rng(0)


def is_picture(path) -> bool:
    return path.read_bytes().startswith(b"\x89PNG") and path.stat().st_size > 5_000


def test_boxes_are_drawn_over_episodes(tmp_path):
    rows = {name: {"jerk_rms": GENERATOR.random(20), "progress": GENERATOR.random(20)} for name in ("PP", "PPT", "X")}
    plot_boxes(rows, {"jerk_rms": "jerk", "progress": "progress"}, tmp_path / "a.png")
    assert is_picture(tmp_path / "a.png")


def test_prior_and_posterior_of_a_primitive_are_drawn_with_its_via_points(tmp_path):
    via = {
        "via_phase": torch.tensor([0.0, 1.0]),
        "via_position": torch.tensor([[0.0, 0.0], [1.0, -1.0]]),
        "via_cov": 1e-4 * torch.eye(2).expand(2, 2, 2),
    }
    plot_promp(ProMP(6, 2, 1.0), via, tmp_path / "a.png", labels=["x [m]", "y [m]"])
    assert is_picture(tmp_path / "a.png")


def test_the_drawn_band_is_that_of_sampled_trajectories():
    promp = ProMP(5, 2, 1.0)
    factor = torch.randn(10, 10, generator=torch.Generator().manual_seed(0))
    promp.weights_cov.copy_(factor @ factor.mT)
    promp.weights_mean.copy_(torch.arange(10.0).reshape(5, 2))
    phase = torch.linspace(0, 1, 4, dtype=torch.float64)
    weights = promp.sample(20_000, torch.Generator().manual_seed(1)).double()
    sampled = promp.decode(weights, phase.expand(20_000, 4))[0][..., 1]
    mean, std = _marginal(promp, promp.prior, phase, 1)
    np.testing.assert_allclose(mean, sampled.mean(0), atol=0.15)
    np.testing.assert_allclose(std, sampled.std(0), rtol=0.03)


def test_tanks_are_drawn_side_by_side(tmp_path):
    column = np.linspace(0, 1, 30)[:, None]
    episode = {"power": column, "tank_energy": 3 - column, "valve": np.ones_like(column)}
    plot_tanks({"PPT": episode, "ST": episode}, tmp_path / "a.png", p_max=2.0, e_max=3.0, dt=0.01)
    assert is_picture(tmp_path / "a.png")


def test_a_film_strip_has_a_row_for_each_variant(tmp_path):
    pictures = [GENERATOR.integers(0, 255, (30, 40, 3), dtype=np.uint8) for _ in range(3)]
    plot_filmstrip({"PP": pictures, "S": pictures}, [0.1, 0.2, 0.3], tmp_path / "a.png", "title")
    assert is_picture(tmp_path / "a.png")


def test_a_calibration_is_drawn_with_and_without_an_audit(tmp_path):
    rows = {"max_power": GENERATOR.random(50), "work": GENERATOR.random(50), "success": np.arange(50) % 2.0}
    plot_calibration(rows, tmp_path / "a.png", p_max=1.0, e_max=1.0)
    audit = {"audit_commanded_power": rows["max_power"], "audit_commanded_work": rows["work"]}
    plot_calibration(rows | audit | {"success": np.zeros(50)}, tmp_path / "b.png", p_max=1.0, e_max=1.0)
    assert is_picture(tmp_path / "a.png")
    assert is_picture(tmp_path / "b.png")


def test_difficulty_is_drawn_for_rates_at_their_bounds(tmp_path):
    curve = ([0.0, 1.0, 2.0], [1.0, 0.5, 0.0], [(0.9, 1.0), (0.3, 0.7), (0.0, 0.1)])
    curves = {"width [mm]": {"PPT": curve, "wall follower": curve}, "rise [cm]": {"PPT": curve}}
    plot_sweep(curves, tmp_path / "difficulty.png", usual={"width [mm]": (0.5, 1.5)})
    assert (tmp_path / "difficulty.png").stat().st_size > 5_000


def test_intervals_of_one_value_do_not_overlap(monkeypatch):
    figures = []
    monkeypatch.setattr("ppt_rl.evaluation.study_figures.save_figure", lambda figure, path: figures.append(figure))
    curve = ([30.0, 40.0, 60.0], [1.0, 1.0, 0.0], [(0.9, 1.0), (0.3, 1.0), (0.0, 0.1)])
    plot_sweep({"width [mm]": {"PPT": curve, "ST": curve, "wall follower": curve}}, Path("never.png"), usual={})
    bars = [sorted(path.vertices[0, 0] for path in c.get_paths()) for c in figures[0].axes[0].collections]
    assert len(bars) == 3
    assert len({round(x, 6) for bar in bars for x in bar}) == 9  # no two at one place
    assert np.diff(sorted(x for bar in bars for x in bar)).min() > 0.01 * 30
    assert len(figures[0].legends) == 1


def test_one_legend_names_each_thing_once_and_stays_within_its_columns():
    figure = Figure(layout="constrained")
    for axes in figure.subplots(1, 3):
        for name in "abcdefg":
            axes.plot([0, 1], label=name)
    one_legend(figure)
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == list("abcdefg")
    assert legend._ncols == 4


def test_levels_of_a_tank_start_at_zero_and_every_panel_is_labelled(monkeypatch):
    figures = []
    monkeypatch.setattr("ppt_rl.evaluation.study_figures.save_figure", lambda figure, path: figures.append(figure))
    column = np.linspace(0, 0.1, 30)[:, None]
    episode = {"power": column, "tank_energy": 3 - column, "valve": np.ones_like(column)}
    plot_tanks({"PPT": episode, "ST": episode}, Path("never.png"), p_max=2.0, e_max=3.0, dt=0.01)
    panels = figures[0].axes
    assert all(axes.get_ylabel() for axes in panels)
    assert all(axes.get_ylim()[0] <= 0 for axes in panels)
    assert len(figures[0].legends) == 1
