"""Training curves of a comparison: success and peak power against control steps and against time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ppt_rl.evaluation.figures import CURVES, moving_average, one_legend, save_figure
from ppt_rl.evaluation.resampling import iqm_interval
from ppt_rl.evaluation.study_figures import GREY, VARIANT_COLORS

__all__ = ["TrainingCurve", "plot_curves"]

Array = NDArray[np.float64]
#: Power that is less than this share of its limit is drawn on a logarithmic axis [-].
_SMALL = 0.3
_TITLE = "Interquartile mean over seeds with its 95 % interval (stratified bootstrap)"


@dataclass(frozen=True)
class TrainingCurve:
    """The curve of one run.

    Attributes:
        batches: ``control_steps``, ``seconds``, ``success`` and ``max_power`` of every batch, ``(T,)`` each.
        validation: ``control_steps``, ``success`` and ``max_power`` of every validation, ``(V,)`` each; V may be 0.
    """

    batches: Mapping[str, Array]
    validation: Mapping[str, Array]

    def minutes(self, steps: Array) -> Array:
        """Time of training after so many control steps [min]."""
        known = self.batches
        times = np.concatenate([[0.0], known["seconds"]]) / 60
        return np.interp(steps, np.concatenate([[0.0], known["control_steps"]]), times)


def plot_curves(curves: Mapping[str, Sequence[TrainingCurve]], path: Path, *, p_max: float, window: int = 3) -> None:
    """Success and peak power against control steps (above) and against time of training (below).

    Args:
        curves: by variant, that of each seed.
        path: path of the picture.
        p_max: power limit to draw [W].
        window: length of the moving average over the exploring policy [batches].
    """
    figure = Figure(figsize=(11, 7.6), layout="constrained")
    grid = figure.subplots(2, 2, sharey="col")
    for row, label, timed in zip(
        grid, ("control steps [million]", "time of training [min]"), (False, True), strict=True
    ):
        for axes, (name, factor, unit) in zip(row, CURVES, strict=True):
            for variant, seeds in curves.items():
                _draw(axes, variant, seeds, name, factor=factor, window=window, against_time=timed)
            axes.set(xlabel=label, ylabel=unit, xlim=(0, None))
            axes.grid(alpha=0.3)
        row[1].axhline(p_max, color="black", ls="--", lw=1.0, zorder=1, label="limit of the tank")
    grid[0, 0].set_ylim(0, 102)
    top = max(float(seed.batches["max_power"].max()) for seeds in curves.values() for seed in seeds)
    if top < _SMALL * p_max:
        grid[0, 1].set_yscale("log")
    else:
        grid[0, 1].set_ylim(0, None)
    if any(_validations(seeds) for seeds in curves.values()):
        grid[0, 1].plot([], [], color="black", lw=2.2, marker="o", ms=4, label="without exploration, in fresh episodes")
    grid[0, 1].plot([], [], color="black", lw=0.9, alpha=0.6, label=f"exploring, mean of {window} batches")
    one_legend(figure)
    figure.suptitle(_TITLE, fontsize=10)
    save_figure(figure, path)


def _validations(seeds: Sequence[TrainingCurve]) -> int:
    """How many validations every run has."""
    return min(len(seed.validation["control_steps"]) for seed in seeds)


def _draw(
    axes: Axes, variant: str, seeds: Sequence[TrainingCurve], name: str, *, factor: float, window: int,
    against_time: bool,
) -> None:  # fmt: skip
    """Curves of one variant: the validated policy where every run has one, and the exploring policy."""
    color = VARIANT_COLORS.get(variant, GREY)
    validated = _validations(seeds)
    kinds = [([moving_average(seed.batches[name], window) for seed in seeds], [seed.batches for seed in seeds])]
    if validated:
        kinds.append(([seed.validation[name] for seed in seeds], [seed.validation for seed in seeds]))
    for values, tables in kinds:
        main = values is kinds[-1][0]
        length = min(map(len, values))
        steps = np.asarray(tables[0]["control_steps"][:length])
        times = np.median([seed.minutes(steps) for seed in seeds], 0)
        scores = factor * np.stack([value[:length] for value in values])
        summaries = [iqm_interval(column[:, None], resamples=500) for column in scores.T]
        x = times if against_time else steps / 1e6
        count = f"{len(seeds)} seed{'s' if len(seeds) > 1 else ''}"
        axes.plot(
            x, [summary["iqm"] for summary in summaries], color=color, lw=2.2 if main and validated else 0.9,
            alpha=1.0 if main else 0.6, label=f"{variant} ({count})" if main else None,
            marker="o" if main and validated else None, ms=4,
        )  # fmt: skip
        if main and len(seeds) > 1:
            low, high = np.asarray([summary["iqm_ci95"] for summary in summaries]).T
            axes.fill_between(x, low, high, color=color, alpha=0.2, lw=0)
