"""What a study keeps of a maze run, and its tables and figures."""

from __future__ import annotations

import gzip
import io
import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from evaluate import as_csv
from evaluate_maze import BASELINES, COLUMNS, Config, evaluate
from numpy.typing import NDArray
from registry import Policy, recipe_of, restored_config
from study_runs import Run, curves_csv

from ppt_rl.envs import paper_layout
from ppt_rl.evaluation import distribution, record_episodes, summarise
from ppt_rl.evaluation.episodes import interval
from ppt_rl.evaluation.study_figures import plot_boxes, plot_curves, plot_promp
from ppt_rl.tasks.maze import fit_maze_prior
from ppt_rl.tasks.maze.figures import plot_layout, plot_rollouts
from ppt_rl.training.logs import write_bytes_atomically, write_text_atomically

__all__ = ["save_maze_run", "write_maze_report"]

Array = NDArray[np.float64]
NAMES = {"ppt_maze": "PPT", "st_maze": "ST"}
#: The paper's table of the real robot (PPT, ST); fractions where ours are.
_PAPER = {
    "success": (0.89, 0.60),
    "jerk_rms": (1.85, 2.70),
    "jerk_rms_slow": (1.85, 2.70),
    "wrench_p95": (8.5, 11.2),
    "overload_ratio": (0.023, 0.031),
    "contact_continuity": (0.74, 0.48),
    "progress": (0.70, 0.76),
}
#: What is compared maze by maze.
_COMPARED = ("success", "jerk_rms", "jerk_rms_slow", "wrench_p95", "contact_continuity", "seconds")
_BOXES = {"jerk_rms": "jerk RMS [m/s³]", "wrench_p95": "P95 force [N]", "seconds": "time [s]"}
#: A second low-pass, for the metric of jerk alone [Hz]: the paper names none, and jerk hangs on it.
_SLOW_CUTOFF = 5.0
_COLUMNS = {**COLUMNS, "jerk_rms_slow": "m/s^3"}
#: Mazes that are driven through together.
_TOGETHER = 100


def save_maze_run(run: Run, policy: Policy, *, episodes: int, seed: int, num_threads: int) -> None:
    """Evaluate a trained maze policy in unseen mazes and keep the results; with seed 0 of PPT the baselines as well.

    Args:
        run: which run.
        policy: its policy.
        episodes: number of mazes.
        seed: of the mazes.
        num_threads: physics threads; 0 takes one per CPU.
    """
    baseline = run.seed == 0 and bool(policy.modules)
    setup = Config(
        run.run_dir, mazes=episodes, seed=seed, num_threads=num_threads, baseline=baseline, num_envs=_TOGETHER
    )
    results = evaluate(policy, setup)
    for name, rows in evaluate(policy, replace(setup, cutoff=_SLOW_CUTOFF)).items():  # the same episodes again
        results[name]["jerk_rms_slow"] = rows["jerk_rms"]
    record = {
        "variant": run.variant, "seed": run.seed, "episodes": episodes, "eval_seed": seed,
        "rows": {name: summarise(rows, _COLUMNS) for name, rows in results.items()},
        "audit": {name: distribution(rows) for name, rows in results.items()},
    }  # fmt: skip
    for name, rows in results.items():
        table = [{key: float(values[i]) for key, values in rows.items()} for i in range(episodes)]
        write_bytes_atomically(run.results / f"{_file(name)}.csv.gz", gzip.compress(as_csv(table).encode(), mtime=0))
    write_bytes_atomically(run.results / "rollouts.npz", _rollouts(policy, seed, num_threads))
    write_text_atomically(run.results / "curves.csv", curves_csv(run))
    shutil.copyfile(run.run_dir / "config.json", run.results / "config.json")
    write_text_atomically(run.results / "evaluation.json", json.dumps(record, indent=2) + "\n")


def _file(name: str) -> str:
    return "episodes" if name in (*NAMES, *NAMES.values()) else name.replace(" ", "_")


def _rollouts(policy: Policy, seed: int, num_threads: int, count: int = 8) -> bytes:
    """Episodes in the paper's maze from several starts, as a compressed archive of arrays."""
    env = policy.make_env(num_envs=count, seed=seed, privileged=True, layouts=[paper_layout()], num_threads=num_threads)
    via = ("via_position", "via_mask") if policy.modules else ()
    episodes = record_episodes(env, policy.actor, ("pose", "wrench", "joint_position", "tank_energy", "valve", *via))
    env.close()
    arrays = {key: value.numpy() for key, value in episodes["trace"].items()}
    arrays["steps"] = episodes["control_steps"].squeeze(-1).numpy()
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer, **{key: value.astype(np.float32) if value.dtype.kind == "f" else value for key, value in arrays.items()}
    )
    return buffer.getvalue()


def write_maze_report(results: Path, runs: Sequence[Run]) -> None:
    """Write tables and figures.

    Args:
        results: directory of the study.
        runs: its finished runs.
    """
    groups = {
        name: [run for run in sorted(runs, key=lambda run: run.seed) if run.variant == variant]
        for variant, name in NAMES.items()
    }
    groups = {name: group for name, group in groups.items() if group}
    text, numbers = _tables(groups)
    write_text_atomically(results / "tables.md", text)
    write_text_atomically(results / "summary.json", json.dumps(numbers, indent=2) + "\n")
    _draw(results, groups)


def _tables(groups: dict[str, list[Run]]) -> tuple[str, dict[str, Any]]:
    tables = {name: [run.episodes() for run in runs] for name, runs in groups.items()}
    first = next(iter(groups.values()))[0]
    tables |= {b: [first.episodes(_file(b))] for b in BASELINES if (first.results / f"{_file(b)}.csv.gz").exists()}
    pooled = {name: _pooled(parts) for name, parts in tables.items()}
    lines = [
        "| | paper, real robot, PPT / ST | " + " | ".join(pooled) + " |", "|---" * (2 + len(pooled)) + "|",
    ]  # fmt: skip
    numbers: dict[str, Any] = {name: summarise(rows, _COLUMNS) for name, rows in pooled.items()}
    for metric, unit in _COLUMNS.items():
        parts = [numbers[name][metric] for name in pooled]
        cells = [f"{part['mean']:.3f} ({part['ci95'][0]:.3f}, {part['ci95'][1]:.3f})" for part in parts]
        paper = " / ".join(f"{value:g}" for value in _PAPER[metric]) if metric in _PAPER else "-"
        lines.append(f"| {metric} [{unit}] | {paper} | " + " | ".join(cells) + " |")
    record = first.evaluation()
    seeds = ", ".join(f"{name} {len(group)}" for name, group in groups.items())
    text = f"""# Tables

Seeds: {seeds}. {record["episodes"]} random mazes (seed {record["eval_seed"]}), the same for all, one deterministic
episode in each by every seed. Velocity and force go through a second-order Butterworth low-pass at 10 Hz, for
jerk_rms_slow at {_SLOW_CUTOFF:g} Hz. The paper's figures are of a real robot in one printed maze, its filter is not
given; ours are of a simulation. Mean over all episodes (95 % interval: Wilson's for rates, else Student's).

{chr(10).join(lines)}

{_differences(tables)}

By seed:

{_by_seed(groups)}
"""
    return text, numbers


def _differences(tables: dict[str, list[dict[str, Array]]]) -> str:
    """The first one less each of the others, maze by maze, every maze's mean over the seeds."""
    means = {
        name: {metric: np.mean([part[metric] for part in parts], 0) for metric in _COMPARED}
        for name, parts in tables.items()
    }
    (first, ours), *others = means.items()
    lines = [
        f"{first} less the others in the same maze, mean over mazes (95 % interval, Student's):", "",
        "| | " + " | ".join(name for name, _ in others) + " |", "|---" * (1 + len(others)) + "|",
    ]  # fmt: skip
    for metric in _COMPARED:
        cells = []
        for _, theirs in others:
            gap = ours[metric] - theirs[metric]
            low, high = interval(gap, is_rate=False)
            cells.append(f"{gap.mean():+.3f} ({low:+.3f}, {high:+.3f})")
        lines.append(f"| {metric} [{_COLUMNS[metric]}] | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _pooled(tables: Sequence[dict[str, Array]]) -> dict[str, Array]:
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


def _by_seed(groups: dict[str, list[Run]]) -> str:
    lines = ["| run | " + " | ".join(_COLUMNS) + " |", "|---" * (1 + len(_COLUMNS)) + "|"]
    for name, runs in groups.items():
        for run in runs:
            row = run.evaluation()["rows"][run.variant]
            cells = [f"{row[metric]['mean']:.3f}" for metric in _COLUMNS]
            lines.append(f"| {name}, seed {run.seed} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _draw(results: Path, groups: dict[str, list[Run]]) -> None:
    """All figures."""
    curves = {
        name: [(table["control_steps"], table) for table in (run.curves() for run in runs)]
        for name, runs in groups.items()
    }
    configs = {name: _config(runs[0]) for name, runs in groups.items()}
    plot_curves(curves, results / "training.png", p_max=next(iter(configs.values())).p_max)
    plot_layout(paper_layout(), results / "paper_maze.png")
    rollouts = {name: _arrays(runs[0]) for name, runs in groups.items() if (runs[0].results / "rollouts.npz").exists()}
    if rollouts:
        plot_rollouts(paper_layout(), rollouts, results / "rollouts.png")
    rows = {name: _pooled([run.episodes() for run in runs]) for name, runs in groups.items()}
    first = next(iter(groups.values()))[0]
    rows |= {b: first.episodes(_file(b)) for b in BASELINES if (first.results / f"{_file(b)}.csv.gz").exists()}
    plot_boxes(rows, _BOXES, results / "metrics.png")
    if "PPT" in configs and not (results / "prior.png").exists():
        config = configs["PPT"]
        promp = fit_maze_prior(recipe_of("ppt_maze").make_modules(config)["promp"], config)
        plot_promp(promp, None, results / "prior.png", labels=["ahead [m]", "left [m]", "up [m]"])


def _config(run: Run) -> Any:
    path = run.results / "config.json"
    return restored_config(recipe_of(run.variant), json.loads(path.read_text())["config"], path)


def _arrays(run: Run) -> dict[str, Array]:
    with np.load(run.results / "rollouts.npz") as file:
        return {name: file[name] for name in file.files}
