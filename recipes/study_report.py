"""Tables and figures of a study, from what its finished runs kept."""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from registry import recipe_of, restored_config
from study_runs import RECORDED, Run

from ppt_rl.evaluation import REPORTED
from ppt_rl.evaluation.statistics import Claim, judge, over_seeds
from ppt_rl.evaluation.study_figures import plot_boxes, plot_curves, plot_filmstrip, plot_promp, plot_tanks
from ppt_rl.evaluation.video import pictures
from ppt_rl.tasks.push import PUSH_AXES, fit_push_prior
from ppt_rl.training.logs import write_text_atomically

#: How the paper calls the variants, in the order of its table.
NAMES = {"pp_push": "PP", "ppt_push": "PPT", "s_push": "S", "st_push": "ST"}
_OTHERS = ("PP", "S", "ST")
#: What the paper says of pushing: PPT against the others, then step-wise against PPT.
CLAIMS = (
    *(Claim("success", "PPT", other, True) for other in _OTHERS),
    *(Claim("success", "PPT", other, False, spread=True) for other in _OTHERS),
    *(
        Claim(metric, "PPT", other, False)
        for metric, other in product(("max_power", "jerk_rms", "wrench_p95", "overload_ratio"), _OTHERS)
    ),
    *(Claim("contact_continuity", "PPT", other, True) for other in _OTHERS),
    *(Claim("progress", other, "PPT", True) for other in ("S", "ST")),
)
_BOXES = {
    "jerk_rms": "jerk RMS [m/s³]",
    "wrench_p95": "P95 force [N]",
    "progress": "progress at T [-]",
    "contact_continuity": "contact continuity [-]",
}

Array = NDArray[np.float64]


def by_variant(runs: Sequence[Run]) -> dict[str, list[Run]]:
    """Runs by the paper's name of their variant, in its order, by seed."""
    ordered = sorted(runs, key=lambda run: run.seed)
    groups = {name: [run for run in ordered if run.variant == variant] for variant, name in NAMES.items()}
    return {name: group for name, group in groups.items() if group}


def seed_means(runs: Sequence[Run], metric: str) -> dict[str, list[float]]:
    """By box and over both, a metric's mean in each seed."""
    boxes = [run.evaluation()["boxes"] for run in runs]
    means = {box: [run_boxes[box][metric]["mean"] for run_boxes in boxes] for box in boxes[0]}
    return means | {"both": [float(np.mean(values)) for values in zip(*means.values(), strict=True)]}


def metrics_table(groups: dict[str, list[Run]]) -> tuple[str, dict[str, Any]]:
    """Markdown table and numbers: every metric over seeds, by box and over both."""
    lines = ["| metric | box | " + " | ".join(groups) + " |", "|---" * (2 + len(groups)) + "|"]
    numbers: dict[str, Any] = {}
    for metric, unit in REPORTED.items():
        means = {name: seed_means(runs, metric) for name, runs in groups.items()}
        for box in next(iter(means.values())):
            cells = []
            for name in groups:
                summary = over_seeds(means[name][box])
                if unit == "0-1" and summary["ci95"] is not None:
                    summary["ci95"] = np.clip(summary["ci95"], 0.0, 1.0).tolist()
                numbers.setdefault(name, {}).setdefault(metric, {})[box] = summary
                cells.append(_cell(summary))
            lines.append(f"| {metric} [{unit}] | {box} | " + " | ".join(cells) + " |")
    return "\n".join(lines), numbers


def _cell(summary: dict[str, Any]) -> str:
    if summary["ci95"] is None:
        return f"{summary['mean']:.3f}"
    low, high = summary["ci95"]
    return f"{summary['mean']:.3f} ± {summary['se']:.3f} ({low:.3f}, {high:.3f}); {summary['iqm']:.3f}"


def power_table(groups: dict[str, list[Run]]) -> str:
    """Markdown table of power and work at control rate and at the physics' rate: mean, P95, max over all episodes."""
    quantities = (
        ("max_power", "peak power, commanded, 100 Hz [W]"),
        ("audit_commanded_power", "the same at the physics' rate [W]"),
        ("max_power_measured", "peak power, measured, 100 Hz [W]"),
        ("audit_measured_power", "the same at the physics' rate [W]"),
        ("work", "work in the books, 100 Hz [J]"),
        ("audit_commanded_work", "work, commanded, at the physics' rate [J]"),
        ("work_gap", "relative gap of the two [-]"),
    )
    lines = [
        "| mean / P95 / max over episodes and seeds | " + " | ".join(groups) + " |",
        "|---" * (1 + len(groups)) + "|",
    ]
    pooled = {name: [run.episodes() for run in runs] for name, runs in groups.items()}
    for key, label in quantities:
        cells = []
        for rows in pooled.values():
            values = np.abs(np.concatenate([row[key] for row in rows]))
            cells.append(f"{values.mean():.3f} / {np.quantile(values, 0.95):.3f} / {values.max():.3f}")
        lines.append(f"| {label} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def orderings_table(groups: dict[str, list[Run]]) -> tuple[str, list[dict[str, Any]]]:
    """Markdown table and verdicts on the paper's claims."""
    lines = ["| the paper says | here | figures | 95 % interval |", "|---|---|---|---|"]
    verdicts = []
    for claim in CLAIMS:
        if claim.better not in groups or claim.worse not in groups:
            continue
        values = {name: seed_means(groups[name], claim.metric)["both"] for name in (claim.better, claim.worse)}
        verdict = judge(claim, values)
        what = f"spread of {claim.metric} over seeds" if claim.spread else claim.metric
        sign = ">" if claim.higher_is_better else "<"
        interval = "-" if verdict["ci95"] is None else f"({verdict['ci95'][0]:.3g}, {verdict['ci95'][1]:.3g})"
        lines.append(
            f"| {what}: {claim.better} {sign} {claim.worse} | {verdict['verdict']} | "
            f"{verdict['better']:.3g} against {verdict['worse']:.3g} | {interval} |"
        )
        verdicts.append({"claim": f"{what}: {claim.better} {sign} {claim.worse}", **verdict})
    return "\n".join(lines), verdicts


def write_report(results: Path, runs: Sequence[Run]) -> None:
    """Write tables and figures.

    Args:
        results: directory of the study.
        runs: its finished runs.
    """
    groups = by_variant(runs)
    metrics, numbers = metrics_table(groups)
    orderings, verdicts = orderings_table(groups)
    record = json.loads((runs[0].results / "config.json").read_text())
    steps, episodes = record["config"]["ppo"]["total_control_steps"], runs[0].evaluation()["episodes"]
    seeds = {name: len(group) for name, group in groups.items()}
    text = f"""# Tables

Seeds: {", ".join(f"{name} {count}" for name, count in seeds.items())}. Each run trained {steps:,} control steps, then
{episodes} fresh episodes on each box, deterministic, privileged box pose removed.

## Metrics

Mean over seeds ± standard error (95 % interval over seeds); interquartile mean. `both` is the mean of the two boxes.

{metrics}

## Power and work

{power_table(groups)}

## The paper's orderings

Intervals: Welch's for a difference of means over seeds (left minus right), from the F distribution for a ratio of
standard deviations. `not resolved`: the interval holds the value of no difference.

{orderings}
"""
    write_text_atomically(results / "tables.md", text)
    summary = {"seeds": seeds, "metrics": numbers, "orderings": verdicts}
    write_text_atomically(results / "summary.json", json.dumps(summary, indent=2) + "\n")
    draw(results, groups)


def draw(results: Path, groups: dict[str, list[Run]]) -> None:
    """All figures."""
    first = next(iter(groups.values()))[0]
    recipe = recipe_of(first.variant)
    settings = json.loads((first.results / "config.json").read_text())["config"]
    config = restored_config(recipe, settings, first.results / "config.json")
    curves = {
        name: [(table["control_steps"], table) for table in (run.curves() for run in runs)]
        for name, runs in groups.items()
    }
    plot_curves(curves, results / "training.png", p_max=config.p_max)
    for label, size in zip(("6cm", "8cm"), sorted(config.box_sizes), strict=False):
        rows = {name: _pooled(runs, size) for name, runs in groups.items()}
        plot_boxes(rows, _BOXES, results / f"metrics_{label}.png")
    tanks = {name: runs[0] for name, runs in groups.items() if "tank_energy" in runs[0].trace()}
    if tanks:
        e_max = json.loads((next(iter(tanks.values())).results / "config.json").read_text())["config"]["e_max"]
        traces = {f"{name}, seed {run.seed}": run.trace() for name, run in tanks.items()}
        plot_tanks(traces, results / "tank.png", p_max=config.p_max, e_max=e_max, dt=config.control_dt)
    draw_scene(results, groups)


def _pooled(runs: Sequence[Run], box_size: float) -> dict[str, Array]:
    tables = [run.episodes() for run in runs]
    chosen = [np.isclose(table["box_size"], box_size) for table in tables]
    return {
        name: np.concatenate([table[name][rows] for table, rows in zip(tables, chosen, strict=True)])
        for name in tables[0]
    }


def draw_scene(results: Path, groups: dict[str, list[Run]], count: int = 6) -> None:
    """The movement primitive with the via-points of one episode, and film strips of that episode."""
    strips: dict[str, list[NDArray[np.uint8]]] = {}
    times: list[float] = []
    for name, runs in groups.items():
        run = runs[0]
        recipe = recipe_of(run.variant)
        settings = json.loads((run.results / "config.json").read_text())["config"]
        config = restored_config(recipe, settings, run.results / "config.json")
        modules = recipe.make_modules(config)
        env = recipe.make_env(config, *modules.values(), num_envs=4, seed=run.evaluation()["eval_seed"])
        episode = env.reset()[RECORDED]
        if modules and not (results / "promp.png").exists():
            promp = fit_push_prior(modules["promp"])
            via = {key: episode[key] for key in ("via_phase", "via_position", "via_cov")}
            labels = [f"{axis} [{'rad' if axis == 'yaw' else 'm'}]" for axis in PUSH_AXES]
            plot_promp(promp, via, results / "promp.png", labels=labels)
        trace = run.trace()
        chosen = np.linspace(0, len(trace["pose"]) - 1, count).round().astype(int)
        times = [config.control_dt * (step + 1) for step in chosen]
        positions = np.concatenate([trace["joint_position"], trace["box_pose"]], -1)[chosen]
        try:
            strips[name] = list(pictures(env.base_env, RECORDED, positions, camera="overview", size=(1280, 960)))
            strips[name] = [picture[320:880:2, 480:1200:2] for picture in strips[name]]  # the table around the box
        except RuntimeError as error:
            print(f"no film strip: {error}")
            return
        finally:
            env.close()
    plot_filmstrip(strips, times, results / "filmstrip.png", "The same episode by each variant, seed 0, deterministic")
