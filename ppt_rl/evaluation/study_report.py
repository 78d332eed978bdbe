"""Tables and figures of a study, from what its finished runs kept."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ppt_rl.evaluation.curve_figures import TrainingCurve, plot_curves
from ppt_rl.evaluation.judge import ALL
from ppt_rl.evaluation.runs import KeptRun
from ppt_rl.evaluation.seed_tables import by_seed, improvement, orderings, over_seeds_table
from ppt_rl.evaluation.seeds import listed_seeds
from ppt_rl.evaluation.statistics import distribution, interval, summarise
from ppt_rl.evaluation.study_figures import plot_boxes, plot_tanks
from ppt_rl.evaluation.tables import markdown, mean_and_interval, power_table
from ppt_rl.evaluation.task import Report
from ppt_rl.training.logs import write_text_atomically

__all__ = ["by_label", "write_report"]

Array = NDArray[np.float64]
Groups = Mapping[str, Sequence[KeptRun]]
Table = dict[str, Array]
_EPISODES = "All episodes of all seeds; mean (95 % interval over episodes: Wilson's for rates, else Student's)."
_AUDIT = "All episodes; `audit` is measured over every physics substep."
_PAIRED = "{} less the others in the same episode; mean over episodes, each averaged over the seeds (95 % interval)."


def by_label(runs: Sequence[KeptRun]) -> dict[str, list[KeptRun]]:
    """Runs by the label of their variant, in the alphabetical order of the variants, by seed.

    Args:
        runs: finished runs.

    Returns:
        The groups.
    """
    ordered = sorted(runs, key=lambda run: (run.recipe.variant, run.seed))
    labels = dict.fromkeys(run.recipe.label for run in ordered)
    return {label: [run for run in ordered if run.recipe.label == label] for label in labels}


def write_report(runs: Sequence[KeptRun], directory: Path) -> None:
    """Write ``tables.md``, ``summary.json`` and figures.

    Args:
        runs: finished runs of one task.
        directory: target directory.
    """
    groups, task = by_label(runs), runs[0].recipe.task
    tables = _tables(groups)
    pooled = {name: _pooled(parts) for name, parts in tables.items()}
    over, numbers = over_seeds_table(groups, task.report)
    ordered, verdicts = orderings(groups, task.report)
    sections = {
        "Metrics over seeds": over,
        "Metrics over episodes": f"{_EPISODES}\n\n{_over_episodes(pooled, task.report)}",
        "Power and work": f"{_AUDIT}\n\n{_power(pooled)}",
        "Episode by episode": _differences(tables, task.report),
        "By seed": by_seed(groups, task.report),
    }
    improved, probabilities = improvement(groups)
    if probabilities:
        sections["Probability of improvement"] = improved
    if verdicts:
        sections["The paper's orderings"] = ordered
    text = "\n\n".join(f"## {title}\n\n{body}" for title, body in sections.items())
    write_text_atomically(directory / "tables.md", f"# Tables\n\n{_head(groups)}\n\n{text}\n")
    seeds = {label: len(part) for label, part in groups.items()}
    summary = {
        "seeds": seeds, "metrics": numbers, "improvement": probabilities, "orderings": verdicts,
        "episodes": {name: summarise(rows, task.report.columns) for name, rows in pooled.items()},
    }  # fmt: skip
    write_text_atomically(directory / "summary.json", json.dumps(summary, indent=2) + "\n")
    _draw(groups, pooled, directory)


def _budget(groups: Groups) -> str:
    """Control steps of a training; by variant, where they differ."""
    steps = {label: part[0].config().ppo.total_control_steps for label, part in groups.items()}
    if len(set(steps.values())) == 1:
        return f"{next(iter(steps.values())):,}"
    return ", ".join(f"{number:,} ({label})" for label, number in steps.items())


def _head(groups: Groups) -> str:
    """How many runs, how long they trained and how they were judged."""
    first = next(iter(groups.values()))[0]
    record = first.evaluation()
    seeds = ", ".join(f"{label} {len(part)}" for label, part in groups.items())
    where = "" if record["groups"] == [ALL] else f" in each group ({', '.join(record['groups'])})"
    return (
        f"Seeds: {seeds}. Each run trained {_budget(groups)} control steps and was then judged in "
        f"{record['episodes']} fresh episodes{where}, the same for all (seed {listed_seeds(record['eval_seed'])}), "
        f"deterministically and without privileged observations. {first.recipe.task.report.note}"
    ).rstrip()


def _tables(groups: Groups) -> dict[str, list[Table]]:
    """Rows of every seed by label, then those of the baselines; several variants may have the same."""
    tables = {label: [run.episodes() for run in runs] for label, runs in groups.items()}
    baselines = [(actor, runs[0]) for runs in groups.values() for actor in runs[0].actors()[1:]]
    names = [actor for actor, _ in baselines]
    for actor, run in baselines:
        tables[actor if names.count(actor) == 1 else f"{actor}, {run.recipe.label}"] = [run.episodes(actor)]
    return tables


def _pooled(tables: Sequence[Table]) -> Table:
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


def _over_episodes(pooled: Mapping[str, Table], report: Report) -> str:
    """Metrics over all episodes, with the paper's figures where it gives some."""
    labels = list(dict.fromkeys(label for figures in report.paper.values() for label in figures))
    paper = [f"paper: {' / '.join(labels)}"] if labels else []
    summaries = {name: summarise(rows, report.columns) for name, rows in pooled.items()}
    lines = []
    for metric, column in report.columns.items():
        figures = report.paper.get(metric, {})
        cell = [" / ".join(f"{figures[label]:g}" for label in labels) if figures else "-"] if labels else []
        cells = [mean_and_interval(summary[metric]) for summary in summaries.values()]
        lines.append([f"{metric} [{column.unit}]", *cell, *cells])
    return markdown(["metric", *paper, *pooled], lines)


def _power(pooled: Mapping[str, Table]) -> str:
    return power_table({name: distribution(rows) for name, rows in pooled.items()})


def _differences(tables: Mapping[str, Sequence[Table]], report: Report) -> str:
    """The first variant less each of the others in the same episode."""
    means = {
        name: {metric: np.mean([part[metric] for part in parts], 0) for metric in report.compared}
        for name, parts in tables.items()
    }
    (first, ours), *others = means.items()
    lines = []
    for metric in report.compared:
        cells = []
        for _, theirs in others:
            gap = ours[metric] - theirs[metric]
            summary = {"mean": gap.mean(), "ci95": interval(gap, is_rate=False)}
            cells.append(mean_and_interval(summary, sign="+"))
        unit = report.columns[metric].unit if metric in report.columns else "s"
        lines.append([f"{metric} [{unit}]", *cells])
    return f"{_PAIRED.format(first)}\n\n{markdown(['metric', *(name for name, _ in others)], lines)}"


def _draw(groups: Groups, pooled: Mapping[str, Table], directory: Path) -> None:
    """The figures of every task, then those of this one."""
    first = next(iter(groups.values()))[0]
    task = first.recipe.task
    curves = {label: [TrainingCurve(run.curves(), run.validation()) for run in runs] for label, runs in groups.items()}
    plot_curves(curves, directory / "training.png", p_max=first.config().p_max)
    for index, group in enumerate(first.evaluation()["groups"]):
        rows = {
            name: {metric: values[table["group"] == index] for metric, values in table.items()}
            for name, table in pooled.items()
        }
        suffix = "" if group == ALL else f"_{group.replace(' ', '_')}"
        plot_boxes(rows, task.report.boxes, directory / f"metrics{suffix}.png")
    tanks = {label: runs[0] for label, runs in groups.items() if runs[0].recipe.has_tank}
    if tanks:
        config = next(iter(tanks.values())).config()
        traces = {}
        for label, run in tanks.items():
            rollouts = run.rollouts()
            steps = int(rollouts.pop("steps")[0])
            traces[f"{label}, seed {run.seed}"] = {name: values[0, :steps] for name, values in rollouts.items()}
        plot_tanks(traces, directory / "tank.png", p_max=config.p_max, e_max=config.e_max, dt=config.control_dt)
    if task.pictures.draw_study is not None:
        task.pictures.draw_study(groups, directory)
