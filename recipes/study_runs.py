"""What a study keeps of a finished run: curves, every evaluated episode, summaries, one recorded episode."""

from __future__ import annotations

import csv
import gzip
import io
import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from evaluate import as_csv
from numpy.typing import NDArray
from registry import Policy

from ppt_rl.evaluation import distribution, record_episodes, run_episodes, save_pretrained, summarise
from ppt_rl.training.logs import read_scalar, versions, write_bytes_atomically, write_text_atomically

_CURVES = (
    "success", "progress", "max_power", "max_power_measured", "jerk_rms", "wrench_p95", "overload_ratio", "work",
    "reward", "kl", "seconds",
)  # fmt: skip
_TRACE = ("joint_position", "pose", "box_pose", "power", "twist", "wrench")
#: Which of the evaluated episodes is recorded.
RECORDED = 0


class Run(NamedTuple):
    """One variant with one seed.

    Attributes:
        variant: name of the recipe's variant.
        seed: of everything random in training.
        run_dir: logs and checkpoints.
        results: what is kept.
    """

    variant: str
    seed: int
    run_dir: Path
    results: Path

    @property
    def finished(self) -> bool:
        """Whether everything was kept; the summaries are written last."""
        return (self.results / "evaluation.json").exists()

    def evaluation(self) -> dict[str, Any]:
        """Summaries: ``boxes`` (metrics by box), ``audit`` (power and work by box), and how they were made."""
        return json.loads((self.results / "evaluation.json").read_text())

    def curves(self) -> dict[str, NDArray[np.float64]]:
        """Logged scalars by name, and ``control_steps``."""
        return _columns((self.results / "curves.csv").read_text())

    def episodes(self, name: str = "episodes") -> dict[str, NDArray[np.float64]]:
        """Every evaluated episode: arrays by metric; ``name`` is that of the file, for a baseline's."""
        return _columns(gzip.decompress((self.results / f"{name}.csv.gz").read_bytes()).decode())

    def trace(self) -> dict[str, NDArray[np.float64]]:
        """The recorded episode: arrays over its control steps."""
        with np.load(self.results / "episode.npz") as file:
            return {name: file[name].astype(np.float64) for name in file.files}


def _columns(text: str) -> dict[str, NDArray[np.float64]]:
    names, *rows = csv.reader(io.StringIO(text))
    data = np.asarray(rows, dtype=float)
    return {name: data[:, index] for index, name in enumerate(names)}


def save_run(run: Run, policy: Policy, *, episodes: int, seed: int, num_threads: int) -> None:
    """Evaluate a trained policy on each box and keep the results.

    Args:
        run: which run.
        policy: its policy.
        episodes: for each box.
        seed: of the episodes.
        num_threads: physics threads; 0 takes one per CPU.
    """
    boxes, audits, rows = {}, {}, []
    num_envs = min(episodes, policy.config.num_envs)
    for size in policy.config.box_sizes:
        env = policy.make_env(num_envs=num_envs, seed=seed, audit=True, box_sizes=(size,), num_threads=num_threads)
        result = run_episodes(env, policy.actor, episodes)
        env.close()
        label = f"{100 * size:.0f} cm"
        boxes[label], audits[label] = summarise(result), distribution(result)
        rows += [{name: float(values[i]) for name, values in result.items()} for i in range(episodes)]
    record = {
        "variant": run.variant, "seed": run.seed, "episodes": episodes, "eval_seed": seed,
        "boxes": boxes, "audit": audits,
    }  # fmt: skip
    write_bytes_atomically(run.results / "episodes.csv.gz", gzip.compress(as_csv(rows).encode(), mtime=0))
    write_bytes_atomically(run.results / "episode.npz", _recorded(policy, seed))
    write_text_atomically(run.results / "curves.csv", curves_csv(run))
    shutil.copyfile(run.run_dir / "config.json", run.results / "config.json")
    write_text_atomically(run.results / "evaluation.json", json.dumps(record, indent=2) + "\n")


def curves_csv(run: Run) -> str:
    """Logged scalars as CSV, a row for each batch in which episodes ended.

    Args:
        run: a trained run.

    Returns:
        The text.
    """
    steps, _ = read_scalar(run.run_dir, "success")
    table = {name: dict(zip(*read_scalar(run.run_dir, name), strict=True)) for name in _CURVES}
    return as_csv([{"control_steps": step, **{name: values[step] for name, values in table.items()}} for step in steps])


def _recorded(policy: Policy, seed: int) -> bytes:
    """One episode as a compressed archive of arrays."""
    env = policy.make_env(num_envs=4, seed=seed, privileged=True)
    tank = ("tank_energy", "valve") if "tank_energy" in env.observation_spec.keys() else ()
    episode = record_episodes(env, policy.actor, (*_TRACE, *tank))[RECORDED]
    env.close()
    arrays = {key: value.numpy().astype(np.float32) for key, value in episode["trace"].items()}
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


def publish(run: Run, policy: Policy, directory: Path) -> None:
    """Write a policy and its card where users find it.

    Args:
        run: a finished run.
        policy: its policy.
        directory: where to.
    """
    record = run.evaluation()
    settings = json.loads((run.run_dir / "config.json").read_text())
    config = {key: value for key, value in settings["config"].items() if key != "variant"}
    config |= {"run_dir": f"runs/{run.variant}", "resume": False}
    card = {
        "variant": run.variant,
        "command": " ".join(["python", f"recipes/{settings['command'][0]}", *settings["command"][1:]]),
        "seed": run.seed,
        "config": config,
        "versions": versions(),
        "evaluation": {key: record[key] for key in ("episodes", "eval_seed", "boxes", "rows") if key in record},
    }
    save_pretrained(directory, {"actor": policy.actor, **policy.modules}, card)
    write_text_atomically(directory / "README.md", _card_text(card))


def _card_text(card: Mapping[str, Any]) -> str:
    evaluation = card["evaluation"]
    in_maze = "rows" in evaluation
    rows: Mapping[str, Any] = evaluation["rows" if in_maze else "boxes"]
    where = "mazes never seen" if in_maze else "fresh episodes a box"
    lines = [
        f"# {card['variant']}, seed {card['seed']}",
        "",
        f"Trained by `{card['command']}` for {card['config']['ppo']['total_control_steps']:,} control steps;",
        f"{evaluation['episodes']} {where} (seed {evaluation['eval_seed']}), deterministic, without privileged",
        "observations; mean (95 % interval over episodes). The last checkpoint of its run, not the best.",
        "",
        f"| {'' if in_maze else 'box'} | " + " | ".join(next(iter(rows.values()))) + " |",
        "|---" * (1 + len(next(iter(rows.values())))) + "|",
    ]
    for box, metrics in rows.items():
        cells = [f"{m['mean']:.3f} ({m['ci95'][0]:.3f}, {m['ci95'][1]:.3f})" for m in metrics.values()]
        lines.append(f"| {box} | " + " | ".join(cells) + " |")
    lines += ["", "Versions: " + ", ".join(f"{name} {number}" for name, number in card["versions"].items()) + ".", ""]
    return "\n".join(lines)
