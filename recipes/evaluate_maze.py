"""Evaluate a maze policy in mazes it has never seen, beside the hand-written wall follower.

``python recipes/evaluate_maze.py CHECKPOINT --mazes 256 --seed 10000 --baseline --report OUT``
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
import tyro
from evaluate import as_csv, audit_table
from registry import Policy, load_policy

from ppt_rl.envs import MazeLayout, MazeRanges
from ppt_rl.evaluation import REPORTED, ZeroPolicy, distribution, record_episodes, run_episodes, summarise
from ppt_rl.evaluation.video import episode_frames, write_video
from ppt_rl.tasks.maze import MazeConfig, make_follower, make_follower_env, make_maze_env
from ppt_rl.training import run_cli
from ppt_rl.training.logs import write_text_atomically

Rows = dict[str, np.ndarray]
#: Who else acts, for comparison.
BASELINES = ("reference alone", "wall follower")
#: What is reported of an episode in the maze, with units.
COLUMNS = {**REPORTED, "seconds": "s", "left_corridor": "0-1", "unsafe": "0-1"}


@dataclass(frozen=True)
class Config:
    """Evaluate a maze policy in unseen mazes: means with 95 % intervals of every metric.

    Attributes:
        checkpoint: a checkpoint, the directory of a run for its newest one, or a published policy.
        mazes: how many random mazes, an episode in each.
        seed: of the mazes; development used the seeds 0 to 99.
        layout: mazes of your own instead, as JSON files.
        num_envs: environments that step together.
        num_threads: physics threads; 0 takes one per CPU.
        cutoff: of the low-pass in the metrics of jerk and force [Hz].
        baseline: add rows for the reference alone (the residual set to zero) and for the wall follower.
        follower_speed: of that wall follower [m/s]: slower is gentler, so compare at equal time.
        json: end with one line of JSON: the metrics of the first row.
        video: write a video of the first mazes here (.mp4), from two cameras.
        film: episodes in the video.
        report: write tables and episodes into this directory.
    """

    checkpoint: Annotated[Path, tyro.conf.Positional]
    mazes: int = 256
    seed: int = 10_000
    layout: tuple[Path, ...] = ()
    num_envs: int = 64
    num_threads: int = 0
    cutoff: float = 10.0
    baseline: bool = False
    follower_speed: float = MazeConfig.follower_speed
    json: bool = False
    video: Path | None = None
    film: int = 1
    report: Path | None = None

    def __post_init__(self) -> None:
        """Refuse impossible settings."""
        for name in ("mazes", "film"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is {getattr(self, name)}; expected at least 1.")
        if not 0 < self.follower_speed < math.inf:
            raise ValueError(f"follower_speed is {self.follower_speed}; expected a speed above 0 m/s.")


def evaluate(policy: Policy, run: Config) -> dict[str, Rows]:
    """Rows of every metric by who acts, all in the same mazes."""
    layouts = [MazeLayout.load(path) for path in run.layout]
    count = len(layouts) or run.mazes
    policy = policy.with_changes({"num_threads": run.num_threads, "cutoff": run.cutoff})
    where: dict[str, Any] = {
        "num_envs": min(run.num_envs, count), "seed": run.seed, "audit": True, "layouts": layouts,
        "ranges": MazeRanges(),
    }  # fmt: skip
    actors: dict[str, Any] = {policy.variant: policy.actor}
    if run.baseline and policy.modules:
        actors[BASELINES[0]] = ZeroPolicy(policy.actor)
    rows = {name: _rows(policy.make_env(**where), actor, count) for name, actor in actors.items()}
    if run.baseline:
        config = replace(policy.config, follower_speed=run.follower_speed)
        rows[BASELINES[1]] = _rows(
            make_follower_env(config, make_maze_env(config, **where)), make_follower(config), count
        )
    return rows


def _rows(env: Any, actor: Any, episodes: int) -> Rows:
    rows = run_episodes(env, actor, episodes)
    rows["seconds"] = rows["control_steps"] * env.base_env.control_dt
    env.close()
    return rows


def table(summaries: dict[str, dict[str, Any]]) -> str:
    """Markdown table of means and intervals, a column for each who acts."""
    names = list(summaries)
    lines = ["| mean (95 % interval) | " + " | ".join(names) + " |", "|---" * (len(names) + 1) + "|"]
    for metric, unit in {**REPORTED, "seconds": "s", "left_corridor": "0-1", "unsafe": "0-1"}.items():
        cells = [
            f"{s['mean']:.3f} ({s['ci95'][0]:.3f}, {s['ci95'][1]:.3f})" for s in (summaries[n][metric] for n in names)
        ]
        lines.append(f"| {metric} [{unit}] | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main(run: Config) -> None:
    """Evaluate and report."""
    policy = load_policy(run.checkpoint)
    if policy.task != "maze":
        raise ValueError(f"{policy.variant} is no maze policy; evaluate it by recipes/evaluate.py.")
    results = evaluate(policy, run)
    summaries = {label: summarise(rows, COLUMNS) for label, rows in results.items()}
    audits = {label: distribution(rows) for label, rows in results.items()}
    count = len(next(iter(results.values()))["success"])
    metrics, power = table(summaries), audit_table(audits)
    print(f"{run.checkpoint}, {count} mazes, seed {run.seed}, metrics' low-pass at {run.cutoff:g} Hz\n\n{metrics}\n")
    print(f"Power and work at control rate, and audited over every physics substep; mean / P95 / max\n\n{power}\n")
    if run.report is not None:
        episodes = [
            {"row": label, **{name: float(values[i]) for name, values in rows.items()}}
            for label, rows in results.items()
            for i in range(count)
        ]
        write_text_atomically(run.report / "evaluation.md", f"{metrics}\n\n{power}\n")
        write_text_atomically(run.report / "evaluation.json", json.dumps(summaries, indent=2) + "\n")
        write_text_atomically(run.report / "episodes.csv", as_csv(episodes))
    if run.video is not None:
        film(policy, run, run.video)
    if run.json:
        print(json.dumps(next(iter(summaries.values()))))


def film(policy: Policy, run: Config, path: Path, every: int = 10) -> None:
    """Write a video of the policy in the first mazes; it runs faster than time."""
    layouts = [MazeLayout.load(source) for source in run.layout]
    env = policy.make_env(
        num_envs=run.film, seed=run.seed, privileged=True, layouts=layouts, num_threads=run.num_threads
    )
    recorded = record_episodes(env, policy.actor, ("joint_position",))
    try:
        frames = episode_frames(env.base_env, recorded, range(run.film), every=every)
        write_video(path, frames, fps=2.0 / (every * policy.config.control_dt))
        print(f"video in {path}, twice as fast as time")
    except RuntimeError as error:
        print(f"no video: {error}")
    env.close()


if __name__ == "__main__":
    torch.set_num_threads(1)
    torch.manual_seed(0)
    run_cli(main, Config)
