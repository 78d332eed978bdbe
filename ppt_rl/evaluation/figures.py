"""Figures of one policy: training curves, and the calibration of a tank."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ppt_rl.functional.argument_checks import require_whole
from ppt_rl.training.logs import read_scalar

__all__ = ["CURVES", "map_axes", "moving_average", "one_legend", "plot_calibration", "plot_training", "save_figure"]

_BLUE, _ORANGE, _GREEN, _GREY = "#1f5fa8", "#d9701a", "#2a9d4a", "#8a8f98"
Array = NDArray[np.float64]
#: Most names in a row of a legend.
_LEGEND_COLUMNS = 5
#: Panels of training curves: scalar, factor to the unit of the axis, label of the axis.
CURVES = (("success", 100.0, "success [%]"), ("max_power", 1.0, "max power of an episode [W]"))


def moving_average(values: Array, window: int) -> Array:
    """Mean over the last ``window`` values, or over all values so far at the start.

    Args:
        values: ``(T,)``.
        window: at least 1.

    Returns:
        ``(T,)``.

    Raises:
        ValueError: if the window is not whole or below 1.
    """
    require_whole("window", window)
    sums = np.cumsum(np.concatenate([[0.0], values]))
    ends = np.arange(1, len(values) + 1)
    starts = np.maximum(0, ends - window)
    return (sums[ends] - sums[starts]) / (ends - starts)


def plot_training(run_dir: Path, path: Path, *, p_max: float | None = None, window: int = 5) -> None:
    """Success and max power against control steps: of the exploring policy, and of the validated one.

    Args:
        run_dir: directory of the run.
        path: path of the picture; its suffix sets the format.
        p_max: power limit to draw [W].
        window: length of the moving average [batches].
    """
    figure = Figure(figsize=(10, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    for axes, (name, factor, label) in zip((left, right), CURVES, strict=True):
        steps, values = read_scalar(run_dir, name)
        axes.plot(steps / 1e6, factor * values, color=_BLUE, alpha=0.25, lw=1)
        label_of_mean = f"exploring, mean of {window} batches"
        axes.plot(steps / 1e6, factor * moving_average(values, window), color=_BLUE, lw=2, label=label_of_mean)
        if (run_dir / "logs" / "csv" / "scalars" / f"validation_{name}.csv").exists():
            steps, values = read_scalar(run_dir, f"validation_{name}")
            axes.plot(steps / 1e6, factor * values, color=_GREEN, marker="o", ms=4, label="without exploration")
        axes.set_xlabel("control steps [million]")
        axes.set_ylabel(label)
        axes.grid(alpha=0.3)
        axes.set_ylim(bottom=0)
    left.set_ylim(0, 102)
    if p_max is not None:
        right.axhline(p_max, color=_ORANGE, ls="--", lw=1.2, label="limit of the tank")
        right.set_ylim(0, 1.1 * p_max)
    one_legend(figure)
    save_figure(figure, path)


def map_axes(axes: Axes, x: Array, y: Array, margin: float = 0.03) -> None:
    """Let axes show the table from above as the arm sees it: x, ahead, points up and y, to the left, points left.

    What is drawn on them has y along the horizontal and x along the vertical axis.

    Args:
        axes: the axes.
        x: all values of x that must fit [m].
        y: all values of y that must fit [m].
        margin: room around them [m].
    """
    axes.set_xlim(float(np.max(y)) + margin, float(np.min(y)) - margin)
    axes.set_ylim(float(np.min(x)) - margin, float(np.max(x)) + margin)
    axes.set(xlabel="y, to the left [m]", ylabel="x, ahead [m]")
    axes.set_aspect("equal")


def one_legend(figure: Figure) -> None:
    """Put one legend under a figure, with what any of its panels has, each name once.

    Args:
        figure: a figure with constrained layout.
    """
    found: dict[str, Any] = {}
    for axes in figure.axes:
        for handle, name in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(name, handle)
    rows = -(-len(found) // _LEGEND_COLUMNS)
    columns = -(-len(found) // rows) if found else 1
    figure.legend(list(found.values()), list(found), loc="outside lower center", ncols=columns)


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure atomically: the file appears complete or not at all.

    Args:
        figure: the figure.
        path: path of the picture; its suffix sets the format.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(f".draft-{path.name}")
    figure.savefig(draft, dpi=120)
    draft.replace(path)


def plot_calibration(rows: Mapping[str, Array], path: Path, *, p_max: float, e_max: float) -> None:
    """Distributions over episodes of peak power and work without limits, and the limits proposed.

    Args:
        rows: arrays over episodes: ``max_power`` [W], ``work`` [J], ``success``, and where audited
            ``audit_commanded_power`` and ``audit_commanded_work``.
        path: path of the picture.
        p_max: proposed power limit [W].
        e_max: proposed capacity [J].
    """
    figure = Figure(figsize=(10, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    success = np.asarray(rows["success"]) > 0.5
    for axes, key, audit, limit, label in (
        (left, "max_power", "audit_commanded_power", p_max, "peak power of an episode [W]"),
        (right, "work", "audit_commanded_work", e_max, "work of an episode [J]"),
    ):
        for values, color, name in (
            (rows[key], _BLUE, "all episodes"),
            (rows[key][success], _GREEN, "successful ones"),
            (rows.get(audit), _GREY, "all, at the physics' rate"),
        ):
            if values is not None and len(values):
                axes.ecdf(values, color=color, lw=1.8, label=name)
        axes.axvline(limit, color=_ORANGE, ls="--", lw=1.4, label=f"proposal {limit:.3g}")
        axes.set_xlabel(label)
        axes.set_ylabel("share of episodes below")
        axes.set_xlim(left=0)
        axes.grid(alpha=0.3)
        axes.legend(loc="lower right")
    save_figure(figure, path)
