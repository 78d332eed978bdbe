"""What a tank costs a policy that never met one, compared with a policy that was trained behind it.

Three policies act in the same episodes behind tanks of several capacities and power limits: PPT, PP with a tank added
at test, and the reference alone. Run ``python benchmarks/tank_at_test.py --report results/push``.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from matplotlib.figure import Figure

from ppt_rl import Policy, load_policy
from ppt_rl.evaluation import ZeroPolicy, run_episodes
from ppt_rl.evaluation.figures import one_legend, save_figure
from ppt_rl.evaluation.statistics import interval
from ppt_rl.evaluation.study_figures import GREY, VARIANT_COLORS
from ppt_rl.training.logs import write_text_atomically


@dataclass(frozen=True)
class Options:
    """Compare policies behind tanks that they were not trained for.

    Attributes:
        behind: policy that was trained behind a tank: a published name, a checkpoint or a run.
        without: policy of the same task that was trained without one.
        episodes: episodes of each point.
        seed: seed of the episodes.
        report: directory of ``tank_at_test.json`` and ``tank_at_test.png``; none writes nothing.
    """

    behind: str = "ppt_push"
    without: str = "pp_push"
    episodes: int = 256
    seed: int = 20000
    report: Path | None = None


#: Capacities [J] at the power limit of the training, and power limits [W] at its capacity.
_E_MAX = (1.0, 1.15, 1.3, 1.5, 2.0, 3.0)
_P_MAX = (1.0, 1.5, 2.0, 3.0, 5.0)


def with_tank(policy: Policy, behind: Policy) -> Policy:
    """A policy in the chain, and with the tank, of another one of the same task.

    Args:
        policy: the policy that acts; it reads nothing that its own chain does not write. Its options that the other one
            lacks, such as those of a constraint, do not count.
        behind: the policy whose chain has the tank.

    Returns:
        The policy behind the tank.
    """
    known = {f.name for f in fields(behind.config)}
    shared = {f.name: getattr(policy.config, f.name) for f in fields(policy.config) if f.name in known}
    config = replace(behind.config, **shared)
    recipe = replace(behind.recipe, make_policy=policy.recipe.make_policy, label=f"{policy.recipe.label} + tank")
    return replace(policy, recipe=recipe, config=config)


def points(trained: dict[str, float]) -> Iterator[tuple[str, dict[str, float]]]:
    """What is varied, and the limits of each point; ``trained`` are those of the training."""
    for varied, values in (("e_max", _E_MAX), ("p_max", _P_MAX)):
        for value in values:
            yield varied, trained | {varied: value}


def measure(policy: Policy, actor: Any, options: Options) -> dict[str, Any]:
    """Success with its interval, and how many episodes the tank acted in."""
    env = policy.make_env(128, seed=options.seed, audit=True)
    rows = run_episodes(env, actor, options.episodes, progress=policy.recipe.label)
    env.close()
    successes = rows["success"] > 0.5
    low, high = interval(successes.astype(float), is_rate=True)
    limits = policy.config
    spent = (rows["work"] > 0.99 * limits.e_max) | (rows["max_power"] > 0.99 * limits.p_max)
    return {
        "success": float(successes.mean()), "low": low, "high": high, "tank_acts": float(spent.mean()),
        "work": float(np.mean(rows["work"])), "max_power": float(np.max(rows["max_power"])),
        "largest_work": float(np.max(rows["work"])),
    }  # fmt: skip


def main(options: Options) -> None:
    """Measure, print and draw."""
    behind, without = load_policy(options.behind), load_policy(options.without)
    actors = {
        "PPT": (behind, behind.actor),
        "PP, tank added at test": (with_tank(without, behind), without.actor),
        "reference alone": (behind, ZeroPolicy(behind.actor)),
    }
    trained = {"p_max": behind.config.p_max, "e_max": behind.config.e_max}
    results: list[dict[str, Any]] = []
    for varied, limits in points(trained):
        for name, (policy, actor) in actors.items():
            row = measure(policy.with_changes(**limits), actor, options)
            results.append({"varied": varied, **limits, "actor": name, **row})
            print(
                f"{name:24} p_max {limits['p_max']:4} W, e_max {limits['e_max']:4} J: success {row['success']:.3f} "
                f"({row['low']:.3f}-{row['high']:.3f}), the tank acts in {row['tank_acts']:.2f}", flush=True,
            )  # fmt: skip
    if options.report is not None:
        record = {"episodes": options.episodes, "seed": options.seed, "trained": trained, "points": results}
        write_text_atomically(options.report / "tank_at_test.json", json.dumps(record, indent=2) + "\n")
        draw(results, trained, options.report / "tank_at_test.png")


def draw(results: list[dict[str, Any]], trained: dict[str, float], path: Path) -> None:
    """Success of each policy by capacity and by power limit; a line marks the limits of the training."""
    figure = Figure(figsize=(10, 4), layout="constrained")
    for axes, (varied, label) in zip(
        figure.subplots(1, 2, sharey=True), (("e_max", "capacity [J]"), ("p_max", "power limit [W]")), strict=True
    ):
        for name in dict.fromkeys(row["actor"] for row in results):
            rows = [row for row in results if row["varied"] == varied and row["actor"] == name]
            x, y = ([row[key] for row in rows] for key in (varied, "success"))
            color = VARIANT_COLORS.get(name.partition(",")[0], GREY)
            axes.plot(x, y, marker="o", ms=4, color=color, label=name)
            axes.fill_between(
                x, [row["low"] for row in rows], [row["high"] for row in rows], color=color, alpha=0.2, lw=0
            )
        axes.axvline(trained[varied], color="black", ls="--", lw=1, label="trained with")
        axes.set(xlabel=label, ylabel="success [0-1]", ylim=(0, 1.01))
        axes.grid(alpha=0.3)
    one_legend(figure)
    figure.suptitle("bands: 95 % intervals over episodes", fontsize=10)
    save_figure(figure, path)


if __name__ == "__main__":
    main(tyro.cli(Options))
