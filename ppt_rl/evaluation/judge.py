"""Evaluation of a policy on its task: rows of every metric, tables, JSON and files."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ppt_rl.evaluation.episodes import Rows, require_run_options, run_episodes
from ppt_rl.evaluation.policy import Policy
from ppt_rl.evaluation.seeds import seeds_of
from ppt_rl.evaluation.statistics import distribution, summarise
from ppt_rl.evaluation.tables import as_csv, metrics_table, power_table
from ppt_rl.training.logs import write_text_atomically

__all__ = ["ALL", "Evaluation", "evaluate", "rows_of"]

#: Label of the group that holds every kind of episode.
ALL = "all"


@dataclass(frozen=True)
class Evaluation:
    """Rows of a policy and of its baselines in the same episodes.

    Attributes:
        policy: the policy that was judged.
        rows: by actor (the variant first) and group: a value an episode for every metric.
    """

    policy: Policy
    rows: Mapping[str, Mapping[str, Rows]]

    @property
    def labelled(self) -> dict[str, Rows]:
        """Rows by label: the actor, and the group where it is not that of all episodes."""
        return {
            actor if group == ALL else f"{actor}, {group}": rows
            for actor, groups in self.rows.items()
            for group, rows in groups.items()
        }

    def summary(self, actor: str, group: str = ALL) -> dict[str, dict[str, Any]]:
        """Means and intervals of an actor.

        Args:
            actor: the policy's variant or a baseline.
            group: label of the group of episodes.

        Returns:
            ``{metric: {"mean": x, "ci95": [low, high]}}``.
        """
        return summarise(self.rows[actor][group], self.policy.recipe.task.report.columns)

    def as_json(self) -> dict[str, Any]:
        """The metrics of the policy; with baselines, theirs by name under ``baselines``."""
        first, *others = self.rows
        baselines = {"baselines": {name: self.summary(name) for name in others}} if others else {}
        return self.summary(first) | baselines

    def tables(self) -> str:
        """Markdown: the metrics, then power and work."""
        summaries = {label: summarise(rows, self.policy.recipe.task.report.columns) for label, rows in self._all()}
        audits = {label: distribution(rows) for label, rows in self._all()}
        return (
            f"{metrics_table(summaries, self.policy.recipe.task.report.columns)}\n\n"
            "Power and work at control rate, and measured over every physics substep (audit):\n\n"
            f"{power_table(audits)}\n"
        )

    def write(self, directory: Path) -> None:
        """Write tables, summaries and every episode.

        Args:
            directory: target directory.
        """
        columns = self.policy.recipe.task.report.columns
        summaries = {label: summarise(rows, columns) for label, rows in self._all()}
        audits = {label: distribution(rows) for label, rows in self._all()}
        episodes = [{"row": label, **row} for label, rows in self._all() for row in rows_of(rows)]
        write_text_atomically(directory / "evaluation.md", self.tables())
        write_text_atomically(directory / "evaluation.json", json.dumps(summaries, indent=2) + "\n")
        write_text_atomically(directory / "audit.json", json.dumps(audits, indent=2) + "\n")
        write_text_atomically(directory / "episodes.csv", as_csv(episodes))

    def _all(self) -> Iterator[tuple[str, Rows]]:
        yield from self.labelled.items()


def evaluate(
    policy: Policy,
    *,
    episodes: int,
    seed: int | Sequence[int],
    num_envs: int = 128,
    groups: bool = False,
    baselines: bool = False,
    everything: bool = True,
) -> Evaluation:
    """Run a policy, and its baselines, deterministically and without privileged observations.

    Args:
        policy: the policy.
        episodes: fresh episodes for each actor and group.
        seed: seed of the episodes; training uses small seeds. Of several seeds, each gives an equal share of them.
        num_envs: number of environments that step together.
        groups: whether each group of episodes of the task is run on its own too.
        baselines: whether the baselines run too, in the same episodes.
        everything: whether all kinds of episodes are run together.

    Returns:
        Rows of every metric.

    Raises:
        ValueError: if a number is out of range.
    """
    seeds = seeds_of(seed)
    for each in seeds:
        require_run_options(episodes=episodes, seed=each, num_envs=num_envs)
    shares = [len(part) for part in np.array_split(np.arange(episodes), len(seeds))]
    changes: dict[str, Mapping[str, Any]] = {ALL: {}} if everything else {}
    if groups:
        found = policy.recipe.task.groups(policy.config)
        changes |= found if len(found) > 1 else ({} if everything else {ALL: {}})
    actors = [policy.variant, *(policy.baselines() if baselines else [])]
    rows: dict[str, dict[str, Rows]] = {actor: {} for actor in actors}
    for group, change in changes.items():
        changed = policy.with_changes(**change)
        for actor in actors:
            label = actor if group == ALL else f"{actor}, {group}"
            parts = [
                _run(changed, actor, share, each, min(num_envs, share), label)
                for share, each in zip(shares, seeds, strict=True)
                if share
            ]
            rows[actor][group] = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return Evaluation(policy, rows)


def _run(policy: Policy, actor: str, episodes: int, seed: int, num_envs: int, label: str) -> Rows:
    """Rows of one actor in one group, with the second passes of the task."""
    report = policy.recipe.task.report
    rows = _pass(policy, actor, episodes, seed, num_envs, label)
    for name, second in report.second_passes.items():
        changed = policy.with_changes(**second.changes)
        rows[name] = _pass(changed, actor, episodes, seed, num_envs, f"{label}, {name}")[second.metric]
    return rows


def _pass(policy: Policy, actor: str, episodes: int, seed: int, num_envs: int, label: str) -> Rows:
    if actor == policy.variant:
        env, acts = policy.make_env(num_envs, seed=seed, audit=True), policy.actor
    else:
        env, acts = policy.make_baseline(actor, num_envs, seed=seed, audit=True)
    keys = (*policy.recipe.task.report.episode_keys, *policy.recipe.episode_keys)
    rows = run_episodes(env, acts, episodes, keys=keys, progress=label)
    rows["seconds"] = rows["control_steps"] * env.base_env.control_dt
    env.close()
    return rows


def rows_of(rows: Rows) -> list[dict[str, float]]:
    """One dictionary an episode.

    Args:
        rows: arrays by metric.

    Returns:
        Metrics by name for each episode.
    """
    count = len(next(iter(rows.values())))
    return [{name: float(np.asarray(values)[i]) for name, values in rows.items()} for i in range(count)]
