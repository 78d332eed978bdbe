"""Evaluate a checkpoint deterministically, without privileged observations.

``python recipes/evaluate.py CHECKPOINT --episodes 512 --seed 10000 --json``
"""

from __future__ import annotations

import csv
import io
import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
import tyro
from registry import Policy, load_policy
from tensordict import TensorDictBase

from ppt_rl.evaluation import (
    POWER_AND_WORK,
    REPORTED,
    ZeroPolicy,
    distribution,
    record_episodes,
    run_episodes,
    summarise,
)
from ppt_rl.evaluation.figures import plot_push_episode, plot_training
from ppt_rl.evaluation.video import episode_frames, write_video
from ppt_rl.training import run_cli
from ppt_rl.training.logs import write_text_atomically

_TRACE = ("joint_position", "pose", "box_pose", "power")


@dataclass(frozen=True)
class Config:
    """Evaluate a checkpoint: means with 95 % intervals of every metric.

    Attributes:
        checkpoint: a checkpoint, the directory of a run for its newest one, or a published policy.
        episodes: fresh episodes for each table row.
        seed: of the episodes; training uses small seeds.
        num_envs: environments that step together.
        num_threads: physics threads; 0 takes one per CPU.
        box_sizes: edges of the boxes to draw from [m]; by default those of the training.
        p_max: power limit of the tank [W]; by default that of the training.
        e_max: capacity of the tank [J]; by default that of the training.
        per_box: add a row for each box size on its own.
        baseline: add rows for the reference alone, the policy's residual set to zero.
        json: end with one line of JSON: the metrics of the first row.
        video: write a video here (.mp4).
        film: episodes in the video.
        plots: write training curves and one episode into this directory.
        report: write table, episodes, plots and video into this directory.
    """

    checkpoint: Annotated[Path, tyro.conf.Positional]
    episodes: int = 512
    seed: int = 10_000
    num_envs: int = 128
    num_threads: int = 0
    box_sizes: tuple[float, ...] = ()
    p_max: float | None = None
    e_max: float | None = None
    per_box: bool = False
    baseline: bool = False
    json: bool = False
    video: Path | None = None
    film: int = 4
    plots: Path | None = None
    report: Path | None = None

    def __post_init__(self) -> None:
        """Refuse impossible settings."""
        if self.film < 1:
            raise ValueError(f"film is {self.film}; expected at least 1 episode.")


def table(rows: dict[str, dict[str, Any]]) -> str:
    """Markdown table of means and intervals."""
    head = "| | " + " | ".join(f"{name} [{unit}]" for name, unit in REPORTED.items()) + " |"
    lines = [head, "|---" * (len(REPORTED) + 1) + "|"]
    for label, summary in rows.items():
        cells = [f"{s['mean']:.3f} ({s['ci95'][0]:.3f}, {s['ci95'][1]:.3f})" for s in summary.values()]
        lines.append(f"| {label} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main(run: Config) -> None:
    """Evaluate and report."""
    policy = load_policy(run.checkpoint)
    if policy.task != "push":
        raise ValueError(f"{policy.variant} is no pushing policy; evaluate it by recipes/evaluate_maze.py.")
    limits = tank_limits(run, policy)
    boxes = run.box_sizes or policy.config.box_sizes
    groups = [boxes] + [(size,) for size in boxes if run.per_box and len(boxes) > 1]
    actors: dict[str, Any] = {policy.variant: policy.actor}
    if run.baseline:
        if not policy.modules:
            raise ValueError(f"{policy.variant} has no reference to run alone; leave --baseline out.")
        actors["reference alone"] = ZeroPolicy(policy.actor)
    results: dict[str, dict[str, np.ndarray]] = {}
    for group in groups:
        for name, actor in actors.items():
            env = policy.make_env(
                num_envs=min(run.num_envs, run.episodes),
                seed=run.seed,
                audit=True,
                box_sizes=group,
                num_threads=run.num_threads,
                **limits,
            )
            label = f"{name}, box {' and '.join(f'{100 * size:.0f}' for size in group)} cm"
            results[label] = run_episodes(env, actor, run.episodes)
            env.close()
    report(run, results)
    draw(run, policy._replace(config=replace(policy.config, **limits)), boxes)
    if run.json:
        print(json.dumps(summarise(next(iter(results.values())))))


def tank_limits(run: Config, policy: Policy) -> dict[str, Any]:
    """Limits that were asked for; a variant without a tank has none."""
    limits = {name: value for name in ("p_max", "e_max") if (value := getattr(run, name)) is not None}
    if limits and not hasattr(policy.config, "e_max"):
        raise ValueError(f"{policy.variant} has no tank; leave {', '.join('--' + name for name in limits)} out.")
    return limits


def report(run: Config, results: dict[str, dict[str, np.ndarray]]) -> None:
    """Print the tables; write them and every episode, where asked for."""
    summaries = {label: summarise(rows) for label, rows in results.items()}
    audits = {label: distribution(rows) for label, rows in results.items()}
    metrics, power = table(summaries), audit_table(audits)
    print(f"{run.checkpoint}, {run.episodes} episodes a row, seed {run.seed}; mean (95 % interval)\n\n{metrics}\n")
    print(f"Power and work at control rate, and audited over every physics substep; mean / P95 / max\n\n{power}\n")
    if run.report is None:
        return
    episodes = [
        {"row": label, **{name: float(values[i]) for name, values in rows.items()}}
        for label, rows in results.items()
        for i in range(run.episodes)
    ]
    write_text_atomically(run.report / "evaluation.md", f"{metrics}\n\n{power}\n")
    write_text_atomically(run.report / "evaluation.json", json.dumps(summaries, indent=2) + "\n")
    write_text_atomically(run.report / "audit.json", json.dumps(audits, indent=2) + "\n")
    write_text_atomically(run.report / "episodes.csv", as_csv(episodes))


def audit_table(audits: dict[str, dict[str, dict[str, float]]]) -> str:
    """Markdown table of means, 95th percentiles and maxima."""
    lines = ["| | " + " | ".join(f"{name} [{unit}]" for name, unit in POWER_AND_WORK.items()) + " |"]
    lines.append("|---" * (len(POWER_AND_WORK) + 1) + "|")
    for label, audit in audits.items():
        cells = [f"{a['mean']:.3f} / {a['p95']:.3f} / {a['max']:.3f}" for a in audit.values()]
        lines.append(f"| {label} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def as_csv(rows: list[dict[str, Any]]) -> str:
    """Rows as CSV text."""
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, fieldnames=list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return buffer.getvalue()


def draw(run: Config, policy: Policy, boxes: tuple[float, ...]) -> None:
    """Plots and video, where asked for."""
    plots = run.plots or run.report
    video = run.video or (run.report / "push.mp4" if run.report is not None else None)
    if plots is None and video is None:
        return
    config = policy.config
    env = policy.make_env(
        num_envs=run.film, seed=run.seed, privileged=True, box_sizes=boxes, num_threads=run.num_threads
    )
    tank = ("tank_energy", "valve") if "tank_energy" in env.observation_spec.keys() else ()
    recorded = record_episodes(env, policy.actor, (*_TRACE, *tank))
    if plots is not None:
        e_max = config.e_max if tank else None
        plot_push_episode(
            as_arrays(recorded[0]), plots / "episode.png", p_max=config.p_max, e_max=e_max, dt=config.control_dt
        )
        run_dir = run.checkpoint if run.checkpoint.is_dir() else run.checkpoint.parent.parent
        if (run_dir / "logs").exists():
            plot_training(run_dir, plots / "training.png", p_max=config.p_max if tank else None)
        print(f"plots in {plots}")
    if video is not None:
        every = 4
        try:
            frames = episode_frames(env.base_env, recorded, range(run.film), every=every)
            write_video(video, frames, fps=1.0 / (every * config.control_dt))
            print(f"video in {video}")
        except RuntimeError as error:
            print(f"no video: {error}")
    env.close()


def as_arrays(episode: TensorDictBase) -> dict[str, np.ndarray]:
    """What the figure of an episode needs."""
    arrays = {key: value.double().numpy() for key, value in episode["trace"].items()}
    return arrays | {key: episode[key].double().numpy() for key in ("goal", "box_size", "via_position")}


if __name__ == "__main__":
    torch.set_num_threads(1)
    torch.manual_seed(0)
    run_cli(main, Config)
