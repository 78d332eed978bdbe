"""What a policy that asks for its energy gets and does with it, beside policies whose tank holds the same for everyone.

All act in the same fresh episodes: the policy with the budget, the same policy with every request replaced by one that
is granted its mean, and policies behind a fixed capacity, both that of their training and that mean. Run
``python benchmarks/energy_budget.py --report results/safety``.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro
from numpy.typing import NDArray
from tank_at_test import with_tank
from tensordict import TensorDictBase

from ppt_rl import Policy, load_policy
from ppt_rl.evaluation import run_episodes
from ppt_rl.evaluation.statistics import interval
from ppt_rl.training.logs import write_text_atomically
from ppt_rl.transforms import EnergyBudgetTransform


@dataclass(frozen=True)
class Options:
    """Compare a policy that asks for its energy with fixed capacities.

    Attributes:
        policy: the policy that asks: a published name, a checkpoint or a run. It decides once an episode.
        fixed: policies behind a tank whose capacity is an option ``e_max``, likewise; where one has no tank, that of
            ``ppt_push`` is added.
        episodes: episodes on each box and of each seed.
        seeds: seeds of the episodes.
        report: directory of ``energy_budget.json``; none writes nothing.
    """

    policy: str = "ppt_budget_push"
    fixed: tuple[str, ...] = ("ppt_push", "lagrangian_push")
    episodes: int = 256
    seeds: tuple[int, ...] = (50_000, 60_000)
    report: Path | None = None


@dataclass
class Watched:
    """A policy that notes how far each box has to go, and may ask for the same energy in every episode.

    Attributes:
        actor: the policy.
        request: what it asks for in the place of its own request; None leaves that.
        distance: distance from box to goal at every decision [m].
    """

    actor: Any
    request: float | None = None
    distance: list[NDArray[Any]] = field(default_factory=list)

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Act, and take notes."""
        way = tensordict["goal"] - tensordict["box_start"]
        self.distance.append(torch.linalg.vector_norm(way, dim=-1).numpy())
        tensordict = self.actor(tensordict)
        if self.request is not None:
            tensordict["action"][..., -1] = self.request
        return tensordict


def request_for(budget: EnergyBudgetTransform, energy: float) -> float:
    """The request that is granted an energy [J], by bisection: what is granted grows with what is asked for."""
    low, high = -50.0, 50.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        granted = float(budget.granted(torch.tensor(middle, dtype=torch.float64)))
        low, high = (middle, high) if granted < energy else (low, middle)
    return 0.5 * (low + high)


def episodes_of(policy: Policy, options: Options, always: float | None = None) -> dict[str, NDArray[Any]]:
    """Rows of every episode, among them ``distance`` [m] and ``granted`` [J]; with ``always``, all are granted that."""
    parts: list[dict[str, NDArray[Any]]] = []
    for group in policy.recipe.task.groups(policy.config).values():
        for seed in options.seeds:
            env = policy.with_changes(**group).make_env(min(128, options.episodes), seed=seed)
            budgets = [part for part in env.transform if isinstance(part, EnergyBudgetTransform)]
            actor = Watched(policy.actor, None if always is None else request_for(budgets[0], always))
            rows = run_episodes(env, actor, options.episodes, keys=policy.recipe.episode_keys)
            env.close()
            rows["distance"] = np.concatenate(actor.distance)[: options.episodes]
            rows["granted"] = rows.get("energy_budget", np.full(options.episodes, policy.config.e_max))
            parts.append(rows)
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def figures_of(rows: dict[str, NDArray[Any]]) -> dict[str, Any]:
    """Success with its interval, what was granted and used, and how what was granted follows the distance."""
    success, granted = rows["success"] > 0.5, rows["granted"]
    low, high = interval(success.astype(float), is_rate=True)
    thirds = np.digitize(rows["distance"], np.quantile(rows["distance"], (1 / 3, 2 / 3)))
    varies = granted.std() > 1e-6
    return {
        "episodes": len(success), "success": float(success.mean()), "low": low, "high": high,
        "granted": float(granted.mean()), "granted_p5": float(np.quantile(granted, 0.05)),
        "granted_p95": float(np.quantile(granted, 0.95)), "granted_max": float(granted.max()),
        "work": float(rows["work"].mean()), "most_of_granted": float((rows["work"] / granted).max()),
        "granted_by_third": [float(granted[thirds == third].mean()) for third in range(3)],
        "success_by_third": [float(success[thirds == third].mean()) for third in range(3)],
        "correlation": float(np.corrcoef(granted, rows["distance"])[0, 1]) if varies else None,
    }  # fmt: skip


def compared(options: Options) -> Iterator[tuple[str, dict[str, Any]]]:
    """Each actor by name, with its figures."""
    policy, named = load_policy(options.policy), Path(options.policy).name
    own = figures_of(episodes_of(policy, options))
    yield f"{named}, as it asks", own
    mean = own["granted"]
    yield f"{named}, always {mean:.2f} J", figures_of(episodes_of(policy, options, always=mean))
    for name in options.fixed:
        other, named = load_policy(name), Path(name).name
        if not other.recipe.has_tank:
            other, named = with_tank(other, load_policy("ppt_push")), f"{named} + tank"
        yield f"{named}, {other.config.e_max:g} J", figures_of(episodes_of(other, options))
        yield f"{named}, {mean:.2f} J", figures_of(episodes_of(other.with_changes(e_max=mean), options))


def main(options: Options) -> None:
    """Measure, print and write."""
    results = {}
    for name, row in compared(options):
        results[name] = row
        shares = ", ".join(f"{value:.2f}" for value in row["success_by_third"])
        energies = ", ".join(f"{value:.2f}" for value in row["granted_by_third"])
        print(
            f"{name:40} success {row['success']:.3f} ({row['low']:.3f}-{row['high']:.3f}), work {row['work']:.3f} J, "
            f"granted {row['granted']:.3f} J ({row['granted_p5']:.2f}-{row['granted_p95']:.2f}); near, middle and far: "
            f"granted {energies} J, success {shares}", flush=True,
        )  # fmt: skip
    if options.report is not None:
        record = {"episodes": options.episodes, "seeds": list(options.seeds), "actors": results}
        write_text_atomically(options.report / "energy_budget.json", json.dumps(record, indent=2) + "\n")


if __name__ == "__main__":
    main(tyro.cli(Options))
