"""Figures of a comparison: boxes over episodes, the movement primitive, tanks, film strips."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from matplotlib.figure import Figure
from numpy.typing import NDArray
from torch import Tensor

from ppt_rl.evaluation.figures import one_legend, save_figure
from ppt_rl.functional.promp import Gaussian
from ppt_rl.modules.promp import ProMP

__all__ = ["GREY", "VARIANT_COLORS", "plot_boxes", "plot_filmstrip", "plot_promp", "plot_sweep", "plot_tanks"]

Array = NDArray[np.float64]
#: One colour per variant; the palette suits colour-blind readers.
VARIANT_COLORS = {"PP": "#e69f00", "PPT": "#0072b2", "S": "#cc79a7", "ST": "#009e73"}
#: Colour of everything else.
GREY = "#8a8f98"
#: By how much points of one value are moved apart, as a share of the axis.
_DODGE = 0.022


def plot_boxes(rows: Mapping[str, Mapping[str, Array]], metrics: Mapping[str, str], path: Path) -> None:
    """Box plots over episodes, one panel per metric: the box spans the quartiles, the whiskers 5 % to 95 %.

    Args:
        rows: by variant, arrays over episodes by metric.
        metrics: labels of the axes by metric.
        path: path of the picture.
    """
    figure = Figure(figsize=(3.1 * len(metrics) + 1.5, 1.2 + 0.35 * len(rows)), layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, len(metrics), sharey=True))
    for axes, (name, label) in zip(panels, metrics.items(), strict=True):
        drawn = axes.boxplot(
            [values[name] for values in rows.values()],
            tick_labels=list(rows) if axes is panels[0] else None,
            manage_ticks=axes is panels[0],
            orientation="horizontal",
            whis=(5, 95),
            showfliers=False,
            patch_artist=True,
            widths=0.6,
            medianprops={"color": "black"},
        )
        for patch, variant in zip(drawn["boxes"], rows, strict=True):
            patch.set(facecolor=VARIANT_COLORS.get(variant, GREY), alpha=0.7)
        axes.set_xlabel(label)
        medians = [np.median(values[name]) for values in rows.values()]
        if min(medians) > 0 and max(medians) > 20 * min(medians):
            axes.set_xscale("log")
        else:
            axes.set_xlim(left=0)
        axes.grid(axis="x", alpha=0.3)
    panels[0].invert_yaxis()  # the first row on top, as in the tables
    figure.supxlabel("box: quartiles over episodes; line: median; whiskers: 5th and 95th percentile", fontsize=9)
    save_figure(figure, path)


def plot_promp(
    promp: ProMP, via: Mapping[str, Tensor] | None, path: Path, *, labels: Sequence[str], samples: int = 101
) -> None:
    """A movement primitive's prior, and its posterior under via-points: one panel per coordinate, +-2 sigma bands.

    Args:
        promp: the primitive.
        via: ``via_phase`` (M,), ``via_position`` (M, D), ``via_cov`` (M, D, D) of one episode; None draws the prior.
        path: path of the picture.
        labels: labels of the coordinates, with units.
        samples: number of samples along the phase.
    """
    phase = torch.linspace(0.0, 1.0, samples, dtype=torch.float64)
    curves = [(promp.prior, GREY, "prior")]
    if via is not None:
        at, position, cov = (via[key].double() for key in ("via_phase", "via_position", "via_cov"))
        curves.append((promp.posterior(at, position, cov), VARIANT_COLORS["PPT"], "posterior"))
    figure = Figure(figsize=(4.2 * len(labels), 3.8), layout="constrained")
    for dof, (axes, label) in enumerate(zip(np.atleast_1d(figure.subplots(1, len(labels))), labels, strict=True)):
        for gaussian, color, name in curves:
            mean, std = _marginal(promp, gaussian, phase, dof)
            axes.plot(phase, mean, color=color, lw=2, label=f"{name}, mean")
            axes.fill_between(
                phase, mean - 2 * std, mean + 2 * std, color=color, alpha=0.2, lw=0, label=f"{name}, ±2 sigma"
            )
        if via is not None:
            error = 2 * cov[:, dof, dof].sqrt()
            axes.errorbar(
                at, position[:, dof], yerr=error, fmt="o", color="black", ms=5, capsize=3, label="via-points, ±2 sigma"
            )
        axes.set_xlabel("phase [-]")
        axes.set_ylabel(label)
        axes.grid(alpha=0.3)
    one_legend(figure)
    save_figure(figure, path)


def _marginal(promp: ProMP, gaussian: Gaussian, phase: Tensor, dof: int) -> tuple[Array, Array]:
    """Mean and standard deviation of one coordinate over the phase."""
    basis = promp.basis(phase)[0].double()  # (T, K)
    span = slice(dof * promp.num_basis, (dof + 1) * promp.num_basis)  # column by column, as vec
    mean = basis @ gaussian.mean[span].double()
    variance = torch.einsum("tk,kl,tl->t", basis, gaussian.cov[span, span].double(), basis)
    return mean.numpy(), variance.clamp_min(0.0).sqrt().numpy()


def plot_tanks(
    episodes: Mapping[str, Mapping[str, Array]], path: Path, *, p_max: float, e_max: float, dt: float
) -> None:
    """Power, tank level and valve over an episode, one column for each.

    Args:
        episodes: by title, arrays over control steps: ``power``, ``tank_energy``, ``valve``, each ``(T, 1)``.
        path: path of the picture.
        p_max: power limit [W].
        e_max: tank capacity [J].
        dt: control step [s].
    """
    figure = Figure(figsize=(4.6 * len(episodes), 6), layout="constrained")
    grid = figure.subplots(3, len(episodes), sharex=True, sharey="row", squeeze=False)
    lines = (
        ("power", "power [W]", p_max),
        ("tank_energy", "tank level [J]", e_max),
        ("valve", "valve [-]", 1.0),
    )
    for column, (title, episode) in enumerate(episodes.items()):
        time = dt * np.arange(1, len(episode["power"]) + 1)
        for axes, (key, label, limit) in zip(grid[:, column], lines, strict=True):
            axes.axhline(limit, color="black", ls="--", lw=1.0, label="limit of power, capacity, valve open")
            if key == "power":
                axes.axhline(-limit, color="black", ls="--", lw=1.0)
                axes.axhline(0.0, color=GREY, lw=0.8)
            else:
                axes.set_ylim(-0.04 * limit, 1.08 * limit)
            axes.plot(time, episode[key][:, 0], color=VARIANT_COLORS["PPT"], lw=1.5)
            axes.grid(alpha=0.3)
            axes.set_ylabel(label)
        grid[0, column].set_title(title)
        grid[2, column].set_xlabel("time [s]")
    one_legend(figure)
    save_figure(figure, path)


def plot_filmstrip(
    strips: Mapping[str, Sequence[NDArray[np.uint8]]], times: Sequence[float], path: Path, title: str = ""
) -> None:
    """Pictures of episodes, one row each, times from left to right.

    Args:
        strips: by row label, pictures of one size.
        times: time of each picture [s].
        path: path of the picture.
        title: title of the figure.
    """
    height, width = next(iter(strips.values()))[0].shape[:2]
    size = 2.4
    figure = Figure(
        figsize=(size * len(times), (size * height / width + 0.05) * len(strips) + 0.6), layout="constrained"
    )
    grid = figure.subplots(len(strips), len(times), squeeze=False)
    for row, (label, pictures) in enumerate(strips.items()):
        for axes, picture, time in zip(grid[row], pictures, times, strict=True):
            axes.imshow(picture)
            axes.set(xticks=[], yticks=[])
            if row == 0:
                axes.set_title(f"{time:.2f} s", fontsize="medium")
        grid[row, 0].set_ylabel(label)
    figure.suptitle(title)
    save_figure(figure, path)


def plot_sweep(
    curves: Mapping[str, Mapping[str, tuple[Sequence[float], Sequence[float], Sequence[Sequence[float]]]]],
    path: Path,
    *,
    usual: Mapping[str, tuple[float, float]],
) -> None:
    """Success against the difficulty of the episodes, one panel per quantity.

    Args:
        curves: by quantity (with unit) and by actor: values, success rates [0-1] and their 95 % intervals.
        path: path of the picture.
        usual: by quantity, the range of the test, which is shaded.
    """
    figure = Figure(figsize=(3.6 * len(curves), 4.0), layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, len(curves), sharey=True))
    for axes, (quantity, actors) in zip(panels, curves.items(), strict=True):
        if quantity in usual:
            axes.axvspan(*usual[quantity], color=GREY, alpha=0.15, lw=0, label="range of the test")
        step = _DODGE * float(np.ptp([value for values, *_ in actors.values() for value in values]))
        for number, (name, (values, rates, intervals)) in enumerate(actors.items()):
            low, high = np.asarray(intervals, dtype=float).T
            error = 100 * np.abs(np.stack([np.asarray(rates) - low, high - np.asarray(rates)]))
            beside = np.asarray(values) + step * (number - 0.5 * (len(actors) - 1))
            axes.errorbar(
                beside, 100 * np.asarray(rates), yerr=error, color=VARIANT_COLORS.get(name, GREY), marker="o", ms=4,
                lw=1.0, elinewidth=1.6, capsize=0, label=name,
            )  # fmt: skip
        axes.set(xlabel=quantity, ylabel="success [%]", ylim=(-3, 103))
        axes.grid(alpha=0.3)
    one_legend(figure)
    figure.suptitle("bars: 95 % intervals; the points of one value stand side by side", fontsize=10)
    save_figure(figure, path)
