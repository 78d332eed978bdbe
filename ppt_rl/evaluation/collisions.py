"""The collision benchmark: how hard a policy presses and strikes when something goes wrong."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ppt_rl.envs.contact_audit import CONTACT
from ppt_rl.evaluation.collision_figure import plot_collisions
from ppt_rl.evaluation.disturbed import in_scenario
from ppt_rl.evaluation.episodes import Rows, require_run_options, run_episodes
from ppt_rl.evaluation.judge import rows_of
from ppt_rl.evaluation.limits import LIMITS, TRANSIENT_FACTOR, shares_above
from ppt_rl.evaluation.policy import Policy
from ppt_rl.evaluation.scenario import Scenario
from ppt_rl.evaluation.spring_energy import SPRING_ENERGY
from ppt_rl.evaluation.tables import markdown
from ppt_rl.training.logs import write_text_atomically

__all__ = ["QUANTITIES", "Collisions", "collide", "scenarios_of"]

#: What is reported of an episode, with its unit.
QUANTITIES = {
    "peak_force": "N", "static_force": "N", "pressure_force": "N", "true_power": "W", "true_work": "J",
    "spring_energy": "J", "contact_speed": "m/s", "held_force": "N",
}  # fmt: skip
#: Observations at the end of an episode that it is made from.
_KEYS = (*CONTACT, "contact", "held_force", "kind", SPRING_ENERGY)


@dataclass(frozen=True)
class Collisions:
    """Rows of several policies in several scenarios, in the same episodes.

    Attributes:
        scenarios: the scenarios.
        rows: by policy and scenario: a value an episode for every quantity of :data:`QUANTITIES`, and ``success``,
            ``contact``, ``contact_time`` and ``kind``.
        labels: names of the policies in the figure, by policy.
    """

    scenarios: Sequence[Scenario]
    rows: Mapping[str, Mapping[str, Rows]]
    labels: Mapping[str, str]

    def summary(self, policy: str, scenario: Scenario) -> dict[str, Any]:
        """What is reported of a policy in a scenario.

        Args:
            policy: label of the policy.
            scenario: the scenario.

        Returns:
            ``{quantity: {"mean": x, "p95": x, "max": x}}``, and ``scenario``, ``policy``, ``episodes``, ``success`` and
            ``contact`` (shares of the episodes), ``above_limits`` (shares of the episodes above the limits of
            ISO/TS 15066) and, where there are several kinds of episodes, the same of each under ``kinds``.
        """
        rows = self.rows[policy][scenario.name]
        kinds = {"kinds": {name: _summary(part) for name, part in _by_kind(scenario, rows)}} if scenario.kinds else {}
        return {"scenario": scenario.name, "policy": policy, **_summary(rows), **kinds}

    def as_json(self) -> dict[str, Any]:
        """One summary for one policy in one scenario; of several scenarios by their names, of several policies too."""
        by_policy = {
            policy: {scenario.name: self.summary(policy, scenario) for scenario in self.scenarios}
            for policy in self.rows
        }
        inner = {
            policy: next(iter(found.values())) if len(found) == 1 else found for policy, found in by_policy.items()
        }
        return next(iter(inner.values())) if len(inner) == 1 else inner

    def groups(self) -> Iterator[tuple[str, dict[str, Rows]]]:
        """Rows by policy for each group of episodes that is reported on its own.

        Yields:
            The name of the scenario, with that of the kind where there are several, and the rows by policy.
        """
        for scenario in self.scenarios:
            parts = {policy: dict(_by_kind(scenario, found[scenario.name])) for policy, found in self.rows.items()}
            for kind in scenario.kinds or ("",):
                name = f"{scenario.name}, {kind}" if kind else scenario.name
                yield name, {policy: found[kind] for policy, found in parts.items()}

    def tables(self) -> str:
        """Markdown: forces, power, work and energy, then shares of the episodes above the limits of ISO/TS 15066."""
        names = [name for name in QUANTITIES if name != "held_force"]
        head = ["scenario", "policy", *(f"{name} [{QUANTITIES[name]}]" for name in names), "contact", "success"]
        bodies = [f"{body} {limit:g} / {TRANSIENT_FACTOR * limit:g} N" for body, limit in LIMITS.items()]
        values, shares = [], []
        for group, found in self.groups():
            for policy, rows in found.items():
                summary = _summary(rows)
                cells = (_cell(summary[name]) for name in names)
                values.append([group, policy, *cells, *(f"{summary[name]:.2f}" for name in ("contact", "success"))])
                above = summary["above_limits"].values()
                shares.append([group, policy, *(f"{x['quasi_static']:.2f} / {x['transient']:.2f}" for x in above)])
        return (
            "Mean / P95 / max over episodes; contact and success are shares of the episodes:\n\n"
            f"{markdown(head, values)}\n\n"
            "Share of the episodes whose static force is above the quasi-static limit of ISO/TS 15066, and whose peak "
            "force is above the transient one:\n\n"
            f"{markdown(['scenario', 'policy', *bodies], shares)}\n"
        )

    def write(self, directory: Path) -> None:
        """Write the tables, the summaries with every episode, and a figure.

        Args:
            directory: target directory.
        """
        summaries = [self.summary(policy, scenario) for policy in self.rows for scenario in self.scenarios]
        for summary in summaries:
            summary["every_episode"] = rows_of(self.rows[summary["policy"]][summary["scenario"]])
        write_text_atomically(directory / "collisions.md", self.tables())
        write_text_atomically(directory / "collisions.json", json.dumps(summaries, indent=1) + "\n")
        drawn = {group: {self.labels[policy]: rows for policy, rows in found.items()} for group, found in self.groups()}
        plot_collisions(drawn, directory / "collisions.png")


def scenarios_of(policies: Mapping[str, Policy], names: Sequence[str] = ()) -> list[Scenario]:
    """Scenarios of the task that policies have in common.

    Args:
        policies: policies by label.
        names: names of scenarios; none takes all.

    Returns:
        The scenarios.

    Raises:
        ValueError: if a policy's task has no scenarios, the policies are of several tasks, or a name is unknown.
    """
    if not policies:
        raise ValueError("no policy is given; expected at least one.")
    for label, policy in policies.items():
        if not policy.recipe.task.scenarios:
            raise ValueError(
                f"{label} is a policy of the task {policy.recipe.task.name!r}, which has no collision scenarios; "
                "expected policies of a task that has some, such as ppt_push."
            )
    tasks = {policy.recipe.task.name: policy.recipe.task for policy in policies.values()}
    if len(tasks) > 1:
        raise ValueError(f"the policies are of the tasks {sorted(tasks)}; expected policies of one task.")
    known = {scenario.name: scenario for scenario in next(iter(tasks.values())).scenarios}
    unknown = [name for name in names if name not in known]
    if unknown:
        raise ValueError(f"scenario {unknown[0]!r} is unknown; expected one of {list(known)}.")
    return [known[name] for name in names] if names else list(known.values())


def collide(
    policies: Mapping[str, Policy],
    *,
    scenarios: Sequence[str] = (),
    episodes: int = 256,
    seed: int = 40_000,
    num_envs: int = 128,
) -> Collisions:
    """Run policies deterministically in the scenarios of their task, all in the same episodes.

    Args:
        policies: policies by label, of one task.
        scenarios: names of scenarios; none takes all.
        episodes: number of episodes of a policy in a scenario.
        seed: seed of the episodes.
        num_envs: number of environments that step together.

    Returns:
        What was measured in every episode.

    Raises:
        ValueError: if the task has no such scenario, the policies are of several tasks, or a number is out of range.
    """
    require_run_options(episodes=episodes, seed=seed, num_envs=num_envs)
    chosen = scenarios_of(policies, scenarios)
    rows: dict[str, dict[str, Rows]] = {label: {} for label in policies}
    for scenario in chosen:
        for label, policy in policies.items():
            acting = in_scenario(policy, scenario)
            env = acting.make_env(min(num_envs, episodes), seed=seed, audit=True)
            found = run_episodes(env, acting.actor, episodes, keys=_KEYS, progress=f"{label}, {scenario.name}")
            env.close()
            found["true_power"], found["true_work"] = (found[f"audit_commanded_{name}"] for name in ("power", "work"))
            rows[label][scenario.name] = {
                name: found[name] for name in (*QUANTITIES, "contact_time", "contact", "success", "kind")
            }
    return Collisions(chosen, rows, _labels(policies))


def _labels(policies: Mapping[str, Policy]) -> dict[str, str]:
    """Labels of the variants; where two are the same, what the policies were called."""
    found = [policy.recipe.label for policy in policies.values()]
    return {name: label if found.count(label) == 1 else name for name, label in zip(policies, found, strict=True)}


def _by_kind(scenario: Scenario, rows: Rows) -> Iterator[tuple[str, Rows]]:
    """Rows of each kind of episodes; where there is one kind only, under the empty name."""
    for number, kind in enumerate(scenario.kinds or ("",)):
        which = rows["kind"] == number if scenario.kinds else slice(None)
        yield kind, {name: values[which] for name, values in rows.items()}


def _summary(rows: Rows) -> dict[str, Any]:
    shares = {name: float(rows[name].mean()) if len(rows[name]) else 0.0 for name in ("success", "contact")}
    limits = shares_above(static=rows["static_force"], peak=rows["peak_force"])
    return {
        "episodes": len(rows["peak_force"]), **{name: _spread(rows[name]) for name in QUANTITIES}, **shares,
        "above_limits": limits,
    }  # fmt: skip


def _spread(values: np.ndarray) -> dict[str, float]:
    if not len(values):
        values = np.zeros(1)
    return {"mean": float(values.mean()), "p95": float(np.percentile(values, 95)), "max": float(values.max())}


def _cell(spread: Mapping[str, float]) -> str:
    digits = 1 if spread["max"] >= 10 else 2
    return " / ".join(f"{spread[name]:.{digits}f}" for name in ("mean", "p95", "max"))
