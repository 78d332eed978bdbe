"""Evaluate a checkpoint deterministically, without privileged observations.

``python recipes/evaluate.py CHECKPOINT --episodes 512 --seed 10000 --json``
"""

from __future__ import annotations

import csv
import importlib
import io
import json
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
import tyro
from tensordict import TensorDictBase
from torch import nn
from torchrl.envs import ExcludeTransform, TransformedEnv

from ppt_rl.training import (
    REPORTED,
    CheckpointMismatch,
    PPOConfig,
    checkpoint_info,
    find_checkpoint,
    load_checkpoint,
    run_cli,
    run_episodes,
    summarise,
)
from ppt_rl.training.evaluation import ZeroPolicy, record_episodes
from ppt_rl.training.logs import write_text_atomically
from ppt_rl.training.plots import plot_push_episode, plot_training
from ppt_rl.training.video import push_frames, write_video

#: Variants and the recipes that build their chains.
RECIPES = {"ppt_push": "ppo_ppt_push"}
#: Observations that exist in simulation only; no evaluated policy sees them.
PRIVILEGED = ("box_pose",)
_TRACE = ("joint_position", "pose", "box_pose", "power", "tank_energy", "valve")


@dataclass(frozen=True)
class Config:
    """Evaluate a checkpoint: means with 95 % intervals of every metric.

    Attributes:
        checkpoint: a checkpoint, or the directory of a run for its newest one.
        episodes: fresh episodes for each table row.
        seed: of the episodes; training uses small seeds.
        num_envs: environments that step together.
        num_threads: physics threads; 0 takes one per CPU.
        box_sizes: edges of the boxes to draw from [m]; by default those of the training.
        per_box: add a row for each box size on its own.
        baseline: add rows for the reference alone, the policy's residual set to zero.
        json: end with one line of JSON: the metrics of the first row.
        video: write a video here (.mp4).
        plots: write training curves and one episode into this directory.
        report: write table, episodes, plots and video into this directory.
    """

    checkpoint: Annotated[Path, tyro.conf.Positional]
    episodes: int = 512
    seed: int = 10_000
    num_envs: int = 128
    num_threads: int = 0
    box_sizes: tuple[float, ...] = ()
    per_box: bool = False
    baseline: bool = False
    json: bool = False
    video: Path | None = None
    plots: Path | None = None
    report: Path | None = None


def load_policy(path: Path) -> tuple[Any, Any, nn.Module, nn.Module]:
    """Recipe, its configuration, movement primitive and actor of a checkpoint."""
    info = checkpoint_info(path)
    if info["variant"] not in RECIPES:
        raise CheckpointMismatch(f"{path} is of variant {info['variant']!r}; expected one of {sorted(RECIPES)}.")
    recipe = importlib.import_module(RECIPES[info["variant"]])
    settings = dict(info["config"])
    settings["ppo"] = PPOConfig(**settings["ppo"])
    settings["box_sizes"] = tuple(settings["box_sizes"])
    known = {field.name for field in fields(recipe.Config)}
    config = recipe.Config(**{name: value for name, value in settings.items() if name in known})
    promp = recipe.blank_promp(config)
    actor, _ = recipe.make_policy(config, recipe.make_env(config, promp, num_envs=1))
    load_checkpoint(path, {"actor": actor, "promp": promp})
    return recipe, config, promp, actor


def make_test_env(
    recipe: Any, config: Any, promp: nn.Module, run: Config, boxes: tuple[float, ...], trace: tuple[str, ...] = ()
) -> TransformedEnv:
    """The recipe's chain without privileged observations."""
    config = replace(config, box_sizes=boxes, num_threads=run.num_threads)
    count = min(run.num_envs, run.episodes)
    env = recipe.make_env(config, promp, num_envs=count, seed=run.seed, trace=trace)
    return env.append_transform(ExcludeTransform(*PRIVILEGED))


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
    path = find_checkpoint(run.checkpoint)
    recipe, config, promp, actor = load_policy(path)
    boxes = run.box_sizes or config.box_sizes
    groups = [boxes] + [(size,) for size in boxes if run.per_box and len(boxes) > 1]
    policies = {recipe.VARIANT: actor} | ({"reference alone": ZeroPolicy(actor)} if run.baseline else {})
    summaries: dict[str, dict[str, Any]] = {}
    episodes: list[dict[str, Any]] = []
    for group in groups:
        for name, policy in policies.items():
            env = make_test_env(recipe, config, promp, run, group)
            rows = run_episodes(env, policy, run.episodes)
            label = f"{name}, box {' and '.join(f'{100 * size:.0f}' for size in group)} cm"
            summaries[label] = summarise(rows)
            episodes += [{"row": label, **{k: float(v[i]) for k, v in rows.items()}} for i in range(run.episodes)]
            env.close()
    text = table(summaries)
    print(f"{path}, {run.episodes} episodes a row, seed {run.seed}; mean (95 % interval)\n\n{text}\n")
    if run.report is not None:
        write_text_atomically(run.report / "evaluation.md", text + "\n")
        write_text_atomically(run.report / "evaluation.json", json.dumps(summaries, indent=2) + "\n")
        write_text_atomically(run.report / "episodes.csv", as_csv(episodes))
    draw(run, path, recipe, config, promp, actor)
    if run.json:
        print(json.dumps(next(iter(summaries.values()))))


def as_csv(rows: list[dict[str, Any]]) -> str:
    """Rows as CSV text."""
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, fieldnames=list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return buffer.getvalue()


def draw(run: Config, path: Path, recipe: Any, config: Any, promp: nn.Module, actor: nn.Module) -> None:
    """Plots and video, where asked for."""
    plots = run.plots or run.report
    video = run.video or (run.report / "push.mp4" if run.report is not None else None)
    if plots is None and video is None:
        return
    few = replace(run, episodes=4, num_envs=4)
    env = make_test_env(recipe, config, promp, few, run.box_sizes or config.box_sizes, trace=_TRACE)
    recorded = record_episodes(env, actor)
    if plots is not None:
        plot_push_episode(
            as_arrays(recorded[0]), plots / "episode.png", p_max=config.p_max, e_max=config.e_max, dt=config.control_dt
        )
        run_dir = path.parent.parent
        if (run_dir / "logs").exists():
            plot_training(run_dir, plots / "training.png", p_max=config.p_max)
        print(f"plots in {plots}")
    if video is not None:
        every = 4
        try:
            frames = push_frames(env.base_env, recorded, range(4), every=every)
            write_video(video, frames, fps=1.0 / (every * config.control_dt))
            print(f"video in {video}")
        except RuntimeError as error:
            print(f"no video: {error}")
    env.close()


def as_arrays(episode: TensorDictBase) -> dict[str, np.ndarray]:
    """What the figure of an episode needs."""
    arrays = {key: episode["trace", key].double().numpy() for key in _TRACE}
    return arrays | {key: episode[key].double().numpy() for key in ("goal", "box_size", "via_position")}


if __name__ == "__main__":
    torch.set_num_threads(1)
    torch.manual_seed(0)
    run_cli(main, Config)
