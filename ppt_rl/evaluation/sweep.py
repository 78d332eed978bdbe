"""Where policies break: success against the difficulty of the episodes, one quantity at a time."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from torchrl.envs import EnvBase

from ppt_rl.evaluation.episodes import require_run_options, run_episodes
from ppt_rl.evaluation.policy import Policy
from ppt_rl.evaluation.statistics import interval
from ppt_rl.evaluation.study_figures import plot_sweep
from ppt_rl.evaluation.task import Task
from ppt_rl.training.logs import write_text_atomically

__all__ = ["redraw_sweep", "run_sweep"]

#: Environments that step together.
_TOGETHER = 96


def run_sweep(
    policies: Sequence[Policy], *, episodes: int, seed: int, baselines: Sequence[str] = (), report: Path
) -> None:
    """Sweep policies of one task; write ``difficulty.json`` and ``difficulty.png``.

    Args:
        policies: the policies.
        episodes: number of episodes at each point.
        seed: seed of the episodes.
        baselines: names of baselines to sweep too, with the options of the first policy.
        report: directory of the results.

    Raises:
        ValueError: if there is no policy, they are of several tasks, their task has no sweep, or a number is out of
            range.
    """
    require_run_options(episodes=episodes, seed=seed)
    tasks = {policy.recipe.task.name: policy.recipe.task for policy in policies}
    sweep = next((task.sweep for task in tasks.values()), None)
    if len(tasks) != 1 or sweep is None:
        raise ValueError(f"the policies are of {sorted(tasks)}; expected policies of one task that has a sweep.")
    unknown = [name for name in baselines if name not in policies[0].baselines()]
    if unknown:
        raise ValueError(f"baselines {unknown} are unknown; expected names from {policies[0].baselines()}.")
    points = sweep.points(episodes, seed)
    given = [episode for point in points for episode in point.given]
    curves: dict[str, dict[str, Any]] = {}
    for label, make in _actors(policies, baselines):
        env, actor = make(min(_TOGETHER, len(given)), seed=seed, given=given)
        success = run_episodes(env, actor, len(given), progress=label)["success"].reshape(len(points), episodes)
        env.close()
        for point, here in zip(points, success, strict=True):
            entry = curves.setdefault(point.quantity, {}).setdefault(label, ([], [], []))
            for values, value in zip(
                entry, (point.value, float(here.mean()), interval(here, is_rate=True)), strict=True
            ):
                values.append(value)
            print(f"{point.quantity} {point.value:g}, {label}: success {here.mean():.2f}", flush=True)
        write_text_atomically(report / "difficulty.json", json.dumps(curves, indent=2) + "\n")
    plot_sweep(curves, report / "difficulty.png", usual=sweep.usual)


def redraw_sweep(task: Task, report: Path) -> None:
    """Draw ``difficulty.png`` anew from ``difficulty.json``.

    Args:
        task: the task of the policies.
        report: directory of both.

    Raises:
        ValueError: if the task has no sweep, or the file cannot be read.
    """
    if task.sweep is None:
        raise ValueError(f"the policies are of {task.name!r}; expected policies of one task that has a sweep.")
    path = report / "difficulty.json"
    try:
        curves = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise ValueError(f"{path} cannot be read ({error}); expected what a sweep wrote. Run one first.") from error
    plot_sweep(curves, report / "difficulty.png", usual=task.sweep.usual)


def _actors(
    policies: Sequence[Policy], baselines: Sequence[str]
) -> Iterator[tuple[str, Callable[..., tuple[EnvBase, Any]]]]:
    """Label, and maker of environment and actor."""
    labels = [policy.recipe.label for policy in policies]
    for policy, label in zip(policies, labels, strict=True):
        name = label if labels.count(label) == 1 else f"{label}, {policy.source}"

        def make(num_envs: int, *, acting: Policy = policy, **settings: Any) -> tuple[EnvBase, Any]:
            return acting.make_env(num_envs, **settings), acting.actor

        yield name, make
    for baseline in baselines:

        def make_baseline(num_envs: int, *, baseline: str = baseline, **settings: Any) -> tuple[EnvBase, Any]:
            return policies[0].make_baseline(baseline, num_envs, **settings)

        yield baseline, make_baseline
