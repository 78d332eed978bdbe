"""Compare the variants of a task over seeds: train, judge, tabulate, publish."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from tqdm import tqdm

from ppt_rl.evaluation.episodes import require_run_options
from ppt_rl.evaluation.policy import Policy, load_policy
from ppt_rl.evaluation.published import save_pretrained
from ppt_rl.evaluation.recipe import Recipe, find_recipe, shipped_recipes
from ppt_rl.evaluation.runs import KeptRun, keep_run
from ppt_rl.evaluation.seeds import listed_seeds, seeds_of
from ppt_rl.evaluation.study_report import write_report
from ppt_rl.evaluation.tables import markdown, mean_and_interval
from ppt_rl.functional.argument_checks import require_whole
from ppt_rl.training import with_settings
from ppt_rl.training.logs import versions, write_text_atomically

__all__ = ["Study", "find_recipes", "run_study"]

#: Largest number of seeds.
_MOST_SEEDS = 1000


@dataclass(frozen=True)
class Study:
    """What a study trains and how it judges.

    Attributes:
        recipes: variants to compare, all of one task.
        seeds: number of seeds, 0 to seeds - 1.
        episodes: evaluated episodes of a run in each group of episodes.
        eval_seed: seed of the evaluated episodes, or several, which share them equally; training uses small seeds.
        num_envs: number of environments that step together in an evaluation.
        settings: options to change in every recipe, as text by name.
        runs: directory of the training runs: logs and checkpoints, some 10 MB each.
        results: directory of the results; None takes ``results/TASK``.
        publish: directory where the policies of seed 0 are published; None publishes none.
    """

    recipes: Sequence[Recipe]
    seeds: int = 3
    episodes: int = 512
    eval_seed: int | Sequence[int] = 10_000
    num_envs: int = 128
    settings: Mapping[str, str] = field(default_factory=dict)
    runs: Path = Path("runs/study")
    results: Path | None = None
    publish: Path | None = None

    def __post_init__(self) -> None:
        """Refuse impossible studies."""
        require_whole("seeds", self.seeds, 1, _MOST_SEEDS)
        for seed in seeds_of(self.eval_seed):
            require_whole("eval_seed", seed, 0)
            require_run_options(episodes=self.episodes, seed=seed, num_envs=self.num_envs)
        others = [recipe for recipe in self.recipes if not isinstance(recipe, Recipe)]
        if others:
            raise ValueError(f"recipes hold {others[0]!r}; expected recipes. Find them by name with find_recipes.")
        tasks = {recipe.task.name for recipe in self.recipes}
        if len(tasks) != 1:
            raise ValueError(f"the recipes are of the tasks {sorted(tasks)}; expected recipes of one task.")
        for recipe in self.recipes:
            with_settings(recipe.config(), self.settings)  # an impossible one shall not wait for its turn

    @property
    def results_dir(self) -> Path:
        """Directory of the results."""
        return self.results or Path("results") / self.recipes[0].task.name

    def planned(self) -> list[KeptRun]:
        """All runs, seed by seed, so that a study cut off early still compares like with like."""
        return [
            KeptRun(recipe, seed, self.runs / _name(recipe, seed), self.results_dir / "runs" / _name(recipe, seed))
            for seed in range(self.seeds)
            for recipe in self.recipes
        ]

    def config(self, run: KeptRun) -> Any:
        """Options of a run: the recipe's defaults but for what the study sets.

        Args:
            run: the run.

        Returns:
            The options.
        """
        config = with_settings(run.recipe.config(), self.settings)
        resume = (run.run_dir / "checkpoints").exists()
        return replace(config, run_dir=run.run_dir, seed=run.seed, resume=resume)


def _name(recipe: Recipe, seed: int) -> str:
    return f"{recipe.variant}-seed{seed}"


def find_recipes(names: Sequence[str]) -> list[Recipe]:
    """Recipes by name.

    Args:
        names: variants, files of recipes, or a task for all variants of its study that come with the library.

    Returns:
        The recipes.

    Raises:
        CheckpointMismatch: if a name is unknown.
    """
    shipped = [find_recipe(variant) for variant in shipped_recipes()]
    tasks = {recipe.task.name for recipe in shipped}
    found: list[Recipe] = []
    for name in names:
        found += [r for r in shipped if r.task.name == name and r.in_study] if name in tasks else [find_recipe(name)]
    return found


def run_study(study: Study, *, report_only: bool = False) -> None:
    """Train and judge the runs that are not finished, then write the report; run it again to continue.

    Args:
        study: the study.
        report_only: train nothing; tables and figures of the runs that are finished.

    Raises:
        ValueError: if no run is finished.
    """
    planned = study.planned()
    for run in tqdm(planned, desc="study", unit=" runs", disable=None):
        if not report_only and not run.finished:
            policy = load_policy(run.recipe.train(study.config(run)))
            keep_run(run, policy, episodes=study.episodes, seed=study.eval_seed, num_envs=study.num_envs)
    finished = [run for run in planned if run.finished]
    if not finished:
        raise ValueError(f"no finished run under {study.results_dir / 'runs'}; leave --report-only out to train some.")
    write_report(finished, study.results_dir)
    for run in finished:
        if study.publish is not None and run.seed == 0 and (run.run_dir / "checkpoints").exists():
            publish(run, load_policy(run.run_dir), study.publish / run.recipe.variant)
    print(f"{len(finished)} of {len(planned)} runs; tables and figures in {study.results_dir}")


def publish(run: KeptRun, policy: Policy, directory: Path) -> None:
    """Write a policy and its card where users find it.

    Args:
        run: a finished run.
        policy: its policy.
        directory: target directory.
    """
    record, settings = run.evaluation(), json.loads((run.run_dir / "config.json").read_text())
    config = {key: value for key, value in settings["config"].items() if key not in ("variant", "recipe")}
    config |= {"run_dir": f"runs/{run.recipe.variant}", "resume": False}
    identity = run.recipe.identity
    if "recipe" in identity:  # so that the card holds no path of this machine
        identity["recipe"] = os.path.relpath(identity["recipe"], directory)
    card = {
        **identity,
        "command": " ".join(settings["command"]),
        "seed": run.seed,
        "config": config,
        "versions": versions(),
        "evaluation": {key: record[key] for key in ("episodes", "eval_seed", "summary")},
    }
    save_pretrained(directory, {"actor": policy.actor, **policy.modules}, card)
    write_text_atomically(directory / "README.md", card_text(card))


def card_text(card: Mapping[str, Any]) -> str:
    """The card of a published policy as Markdown.

    Args:
        card: its content.

    Returns:
        The text.
    """
    evaluation = card["evaluation"]
    rows = {
        f"{actor}, {group}": row for actor, groups in evaluation["summary"].items() for group, row in groups.items()
    }
    metrics = list(next(iter(rows.values())))
    table = markdown(
        ["", *metrics], [[label, *(mean_and_interval(row[name]) for name in metrics)] for label, row in rows.items()]
    )
    return f"""# {card["variant"]}, seed {card["seed"]}

Trained by `{card["command"]}` for {card["config"]["ppo"]["total_control_steps"]:,} control steps;
{evaluation["episodes"]} fresh episodes a row (seed {listed_seeds(evaluation["eval_seed"])}), deterministic, without
privileged observations; mean (95 % interval over episodes). It is the last checkpoint of its run, not the best.

{table}

Versions: {", ".join(f"{name} {number}" for name, number in card["versions"].items())}.
"""
