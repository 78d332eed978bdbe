"""The figure of the collision benchmark: peak and static force beside the limits of ISO/TS 15066."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ppt_rl.evaluation.figures import save_figure
from ppt_rl.evaluation.limits import LIMITS, TRANSIENT_FACTOR
from ppt_rl.evaluation.study_figures import GREY, VARIANT_COLORS

__all__ = ["plot_collisions"]

#: Colours of policies that are no variant of the paper, in order; with those of the variants they suit colour-blind
#: readers.
_OTHERS = ("#56b4e9", "#d55e00", "#f0e442", "#000000", GREY)
#: Share of the room of a group that its bars fill.
_FILLED = 0.8


def plot_collisions(groups: Mapping[str, Mapping[str, Mapping[str, NDArray[Any]]]], path: Path) -> None:
    """Bars of the mean force with a whisker to the 95th percentile and a dot at the maximum, a bar for each policy.

    Args:
        groups: by group of episodes and policy, arrays over episodes with ``peak_force`` and ``static_force`` [N].
        path: path of the picture.
    """
    policies = list(next(iter(groups.values())))
    width = max(7.0, 1.5 + len(groups) * (0.5 + 0.22 * len(policies)))
    figure = Figure(figsize=(width, 7.2), layout="constrained")
    panels = figure.subplots(2, 1, sharex=True)
    for axes, name, factor, title in (
        (panels[0], "peak_force", TRANSIENT_FACTOR, "peak force [N], with the transient limits"),
        (panels[1], "static_force", 1.0, "static force [N], with the quasi-static limits"),
    ):
        _draw_bars(axes, {group: {p: rows[name] for p, rows in found.items()} for group, found in groups.items()})
        _draw_limits(axes, factor, len(groups))
        axes.set_ylabel("force [N]")
        axes.set_title(title, fontsize="medium", loc="left")
        axes.set_ylim(bottom=0)
        axes.grid(axis="y", alpha=0.3)
    panels[1].set_xticks(range(len(groups)), [group.replace(", ", "\n") for group in groups])
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
    figure.supxlabel("bar: mean over episodes; whisker: 95th percentile; dot: maximum", fontsize=9)
    save_figure(figure, path)


def _draw_bars(axes: Any, groups: Mapping[str, Mapping[str, NDArray[Any]]]) -> None:
    policies = list(next(iter(groups.values())))
    bar = _FILLED / len(policies)
    others = iter(_OTHERS * len(policies))
    for number, policy in enumerate(policies):
        place = np.arange(len(groups)) + (number - 0.5 * (len(policies) - 1)) * bar
        values = [found[policy] for found in groups.values()]
        mean, p95, most = (
            np.asarray([measure(value) if len(value) else 0.0 for value in values])
            for measure in (np.mean, lambda value: np.percentile(value, 95), np.max)
        )
        color = VARIANT_COLORS.get(policy) or next(others)
        axes.bar(place, mean, 0.92 * bar, color=color, label=policy, zorder=2)
        whisker = np.stack([np.zeros_like(mean), np.maximum(p95 - mean, 0.0)])
        axes.errorbar(place, mean, yerr=whisker, fmt="none", ecolor="black", elinewidth=1, capsize=2, zorder=3)
        axes.plot(place, most, ls="none", marker=".", ms=4, color="black", zorder=3)


def _draw_limits(axes: Any, factor: float, groups: int) -> None:
    """A line for each limit, with the parts of the body that it is for."""
    axes.set_xlim(-0.6, groups - 0.4)
    for limit in sorted(set(LIMITS.values())):
        bodies = ", ".join(body for body, value in LIMITS.items() if value == limit)
        axes.axhline(factor * limit, color="#b3261e", ls="--", lw=1, zorder=1)
        axes.annotate(
            f"{bodies} {factor * limit:g} N", (1.0, factor * limit), xycoords=("axes fraction", "data"),
            xytext=(4, 0), textcoords="offset points", va="center", fontsize=8, color="#b3261e",
        )  # fmt: skip
