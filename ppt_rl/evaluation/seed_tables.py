"""Tables of a study that compare seeds with seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import permutations
from typing import Any

import numpy as np

from ppt_rl.evaluation.judge import ALL
from ppt_rl.evaluation.resampling import iqm_interval, probability_of_improvement
from ppt_rl.evaluation.runs import KeptRun
from ppt_rl.evaluation.statistics import judge, over_seeds
from ppt_rl.evaluation.tables import markdown
from ppt_rl.evaluation.task import Report

__all__ = ["by_seed", "improvement", "orderings", "over_seeds_table"]

Groups = Mapping[str, Sequence[KeptRun]]
_SEEDS = (
    "Mean over seeds ± standard error (95 % interval over seeds, Student's); interquartile mean (95 % interval by "
    "stratified bootstrap over the seeds in each group of episodes)."
)
_IMPROVEMENT = (
    "How probable it is that a run of the variant on the left succeeds more often than a run of the one above, on the "
    "same episodes (95 % interval by stratified bootstrap). At 0.5 neither is better."
)
_ORDERINGS = (
    "Intervals: Welch's for a difference of means over seeds (left minus right), from the F distribution for a ratio "
    "of standard deviations. `not resolved`: the interval contains the value of no difference."
)


def over_seeds_table(groups: Groups, report: Report) -> tuple[str, dict[str, Any]]:
    """Every metric over seeds, by group of episodes and over all.

    Args:
        groups: runs by the label of their variant.
        report: the metrics.

    Returns:
        Markdown, and the numbers by label, metric and group of episodes.
    """
    numbers: dict[str, Any] = {label: {} for label in groups}
    lines = []
    for metric, column in report.columns.items():
        means = {label: [_seed_means(run, metric) for run in runs] for label, runs in groups.items()}
        for group in next(iter(means.values()))[0]:
            cells = []
            for label, values in means.items():
                summary = _summary(values, group, is_share=column.unit == "0-1")
                numbers[label].setdefault(metric, {})[group] = summary
                cells.append(_seeds_cell(summary))
            lines.append([f"{metric} [{column.unit}]", group, *cells])
    return f"{_SEEDS}\n\n{markdown(['metric', 'episodes', *groups], lines)}", numbers


def by_seed(groups: Groups, report: Report) -> str:
    """Markdown: the metrics of every run.

    Args:
        groups: runs by the label of their variant.
        report: the metrics.

    Returns:
        The table.
    """
    lines = [
        [f"{label}, seed {run.seed}", *(f"{_seed_means(run, metric)[ALL]:.3f}" for metric in report.columns)]
        for label, runs in groups.items()
        for run in runs
    ]
    return markdown(["run", *report.columns], lines)


def improvement(groups: Groups) -> tuple[str, dict[str, Any]]:
    """How probable it is that a run of one variant succeeds more often than a run of another.

    Args:
        groups: runs by the label of their variant.

    Returns:
        Markdown, and by the pair ``"A > B"`` the probability with its interval; nothing for a single variant.
    """
    success = {label: [_apart(_seed_means(run, "success")) for run in runs] for label, runs in groups.items()}
    pairs = {f"{a} > {b}": probability_of_improvement(success[a], success[b]) for a, b in permutations(groups, 2)}
    lines = [[a, *("-" if a == b else _probability_cell(pairs[f"{a} > {b}"]) for b in groups)] for a in groups]
    return f"{_IMPROVEMENT}\n\n{markdown(['', *groups], lines)}", pairs


def orderings(groups: Groups, report: Report) -> tuple[str, list[dict[str, Any]]]:
    """Verdicts on the orderings that the paper claims.

    Args:
        groups: runs by the label of their variant.
        report: the claims.

    Returns:
        Markdown, and the verdicts.
    """
    lines, verdicts = [], []
    for claim in report.claims:
        if claim.better not in groups or claim.worse not in groups:
            continue
        values = {
            name: [_seed_means(run, claim.metric)[ALL] for run in groups[name]] for name in (claim.better, claim.worse)
        }
        verdict = judge(claim, values)
        what = f"spread of {claim.metric} over seeds" if claim.spread else claim.metric
        claimed = f"{what}: {claim.better} {'>' if claim.higher_is_better else '<'} {claim.worse}"
        between = "-" if verdict["ci95"] is None else f"({verdict['ci95'][0]:.3g}, {verdict['ci95'][1]:.3g})"
        figures = f"{verdict['better']:.3g} against {verdict['worse']:.3g}"
        lines.append([claimed, verdict["verdict"], figures, between])
        verdicts.append({"claim": claimed, **verdict})
    table = markdown(["the paper says", "here", "figures", "95 % interval"], lines)
    return f"{_ORDERINGS}\n\n{table}", verdicts


def _seed_means(run: KeptRun, metric: str) -> dict[str, float]:
    """A metric's mean in each group of episodes, and over the groups."""
    names, rows = run.evaluation()["groups"], run.episodes()
    means = {name: float(rows[metric][rows["group"] == index].mean()) for index, name in enumerate(names)}
    return means | {ALL: float(np.mean(list(means.values())))}


def _apart(means: Mapping[str, float]) -> list[float]:
    """Means of the groups of episodes without that over all; where there is only that one, it alone."""
    return [value for name, value in means.items() if name != ALL] or [means[ALL]]


def _summary(values: Sequence[Mapping[str, float]], group: str, *, is_share: bool) -> dict[str, Any]:
    """Mean and interquartile mean over seeds with their intervals; those of a share stay within [0, 1]."""
    parts = [_apart(value) if group == ALL else [value[group]] for value in values]
    summary = over_seeds([value[group] for value in values]) | iqm_interval(parts)
    if is_share and summary["ci95"] is not None:
        summary["ci95"] = np.clip(summary["ci95"], 0.0, 1.0).tolist()
    return summary


def _seeds_cell(summary: Mapping[str, Any]) -> str:
    if summary["ci95"] is None:
        return f"{summary['mean']:.3f}"
    student, bootstrap = (f"({low:.3f}, {high:.3f})" for low, high in (summary["ci95"], summary["iqm_ci95"]))
    return f"{summary['mean']:.3f} ± {summary['se']:.3f} {student}; {summary['iqm']:.3f} {bootstrap}"


def _probability_cell(result: Mapping[str, Any]) -> str:
    between = "" if result["ci95"] is None else " ({:.2f}, {:.2f})".format(*result["ci95"])
    return f"{result['probability']:.2f}{between}"
