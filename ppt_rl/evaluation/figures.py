"""Figures of a run: training curves, and one episode from above and over time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from numpy.typing import NDArray

from ppt_rl.training.logs import read_scalar

__all__ = ["moving_average", "plot_calibration", "plot_push_episode", "plot_training", "save_figure"]

_BLUE, _ORANGE, _GREEN, _GREY = "#1f5fa8", "#d9701a", "#2a9d4a", "#8a8f98"
Array = NDArray[np.float64]


def moving_average(values: Array, window: int) -> Array:
    """Mean over the last ``window`` values; at the start, over those there are.

    Args:
        values: ``(T,)``.
        window: at least 1.

    Returns:
        ``(T,)``.

    Raises:
        ValueError: if the window is below 1.
    """
    if window < 1:
        raise ValueError(f"window is {window}; expected at least 1.")
    sums = np.cumsum(np.concatenate([[0.0], values]))
    ends = np.arange(1, len(values) + 1)
    starts = np.maximum(0, ends - window)
    return (sums[ends] - sums[starts]) / (ends - starts)


def plot_training(run_dir: Path, path: Path, *, p_max: float | None = None, window: int = 5) -> None:
    """Success and max power against control steps.

    Args:
        run_dir: directory of the run.
        path: where the picture goes; its suffix names the format.
        p_max: power limit to draw [W].
        window: of the moving average [batches].
    """
    figure = Figure(figsize=(10, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    for axes, name, factor, label in (
        (left, "success", 100.0, "success [%]"),
        (right, "max_power", 1.0, "max power per episode [W]"),
    ):
        steps, values = read_scalar(run_dir, name)
        axes.plot(steps / 1e6, factor * values, color=_BLUE, alpha=0.25, lw=1, label="batch")
        axes.plot(steps / 1e6, factor * moving_average(values, window), color=_BLUE, lw=2, label=f"mean of {window}")
        axes.set_xlabel("control steps [million]")
        axes.set_ylabel(label)
        axes.grid(alpha=0.3)
        axes.set_ylim(bottom=0)
    left.set_ylim(0, 102)
    if p_max is not None:
        right.axhline(p_max, color=_ORANGE, ls="--", lw=1.2, label="limit")
        right.set_ylim(0, 1.1 * p_max)
    left.legend(loc="lower right")
    right.legend(loc="best")
    figure.suptitle("Training with the exploring policy")
    save_figure(figure, path)


def plot_push_episode(
    episode: Mapping[str, Array], path: Path, *, p_max: float, dt: float, e_max: float | None = None
) -> None:
    """One pushing episode: the scene from above, and power, tank level and valve over time.

    Args:
        episode: arrays over T control steps: ``pose`` (T, 7), ``box_pose`` (T, 7), ``power`` (T, 1), and where there is
            a tank ``tank_energy`` (T, 1) and ``valve`` (T, 1); and ``goal`` (2,), ``box_size`` (1,), ``via_position``
            (M, 3).
        path: where the picture goes.
        p_max: power limit [W].
        e_max: tank capacity [J]; None where there is no tank.
        dt: control step [s].
    """
    rows = [("power", "power [W]", p_max, "limit")]
    if e_max is not None:
        rows += [("tank_energy", "tank level [J]", e_max, "capacity"), ("valve", "valve [-]", 1.0, "open")]
    figure = Figure(figsize=(12, 5.2), layout="constrained")
    grid = figure.add_gridspec(len(rows), 2, width_ratios=(1.25, 1))
    _draw_scene(figure.add_subplot(grid[:, 0]), episode)
    time = dt * np.arange(1, len(episode["power"]) + 1)
    for row, (key, label, limit, name) in enumerate(rows):
        values = episode[key]
        axes = figure.add_subplot(grid[row, 1])
        axes.plot(time, values[:, 0], color=_BLUE, lw=1.8)
        axes.axhline(limit, color=_ORANGE, ls="--", lw=1.2, label=name)
        axes.set_ylabel(label)
        axes.set_ylim(1.1 * min(0.0, float(values.min())), 1.12 * max(limit, float(values.max())))
        axes.grid(alpha=0.3)
        axes.legend(loc="center right")
        if row < len(rows) - 1:
            axes.tick_params(labelbottom=False)
        else:
            axes.set_xlabel("time [s]")
    save_figure(figure, path)


def _draw_scene(axes: Axes, episode: Mapping[str, Array]) -> None:
    tool, box, half = episode["pose"], episode["box_pose"], 0.5 * float(episode["box_size"][0])
    corners = half * np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
    for step in np.linspace(0, len(tool) - 1, 9).astype(int):
        alpha = 0.25 + 0.75 * step / len(tool)
        axes.add_patch(Polygon(_placed(corners, box[step]), closed=True, fill=False, ec=_ORANGE, lw=1.5, alpha=alpha))
        bar = _placed(np.array([[0.0, -0.06], [0.0, 0.06]]), tool[step], tool_down=True)
        axes.plot(bar[:, 0], bar[:, 1], color=_BLUE, lw=2.5, alpha=alpha, solid_capstyle="round")
    axes.plot(tool[:, 0], tool[:, 1], color=_BLUE, lw=1, label="tool")
    axes.plot(box[:, 0], box[:, 1], color=_ORANGE, lw=1, label="box")
    via = episode["via_position"]
    axes.plot(via[:, 0], via[:, 1], "x", color="black", ms=8, mew=2, label="via-points")
    axes.add_patch(Circle(tuple(episode["goal"]), 0.02, color=_GREEN, alpha=0.5, label="goal, 2 cm"))
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.grid(alpha=0.3)
    axes.legend(loc="best")


def _placed(points: Array, pose: Array, *, tool_down: bool = False) -> Array:
    """Points of a body, in the plane, at a pose. A tool-down body is turned over: its y axis points the other way."""
    w, x, y, z = pose[3:]
    axis_x = np.array([1 - 2 * (y * y + z * z), 2 * (x * y + w * z)])
    axis_y = np.array([2 * (x * y - w * z), 1 - 2 * (x * x + z * z)])
    if tool_down:
        axis_y = -axis_y
    return pose[:2] + points[:, :1] * axis_x + points[:, 1:] * axis_y


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure so that it is there whole or not at all.

    Args:
        figure: what to write.
        path: its suffix names the format.
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
        path: where the picture goes.
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
