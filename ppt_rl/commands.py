"""The subcommands of ``ppt-rl``: their options, and what they do. Heavy imports wait until one is run."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    from ppt_rl.evaluation import Policy

__all__ = ["CalibrateTank", "Evaluate", "Film", "Judged", "Policies", "Study", "Sweep", "Train"]


_Settings = Annotated[tuple[str, ...], tyro.conf.arg(name="set", metavar="NAME=VALUE ...")]


@dataclass(frozen=True)
class Judged:
    """A policy and where it acts.

    Attributes:
        policy: name of a published policy, or path of a checkpoint, a run or a directory with a card.
        recipe: variant or file of the recipe; by default the one that trained the policy.
        settings: options of the recipe to change, as NAME=VALUE: `--set p_max=0.5 box_sizes=0.06`.
        seed: seed of the episodes; training uses small seeds.
        num_envs: number of environments that step together.
        num_threads: physics threads; 0 takes one per CPU.
    """

    policy: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="POLICY")]
    recipe: str | None = None
    settings: _Settings = ()
    seed: int = 10_000
    num_envs: int = 128
    num_threads: int = 0

    def load(self) -> Policy:
        """Load the policy with its changed options."""
        return _load(self.policy, self.recipe, (*self.settings, f"num_threads={self.num_threads}"))


@dataclass(frozen=True)
class Train:
    """Train a variant; ``ppt-rl train VARIANT --help`` shows its options.

    Attributes:
        variant: name of a variant, or file of a recipe.
    """

    variant: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="VARIANT")]


@dataclass(frozen=True)
class Evaluate(Judged):
    """Judge a policy deterministically, without privileged observations: means with 95 % intervals.

    Attributes:
        episodes: number of fresh episodes for each column of the tables.
        per_group: add columns for each group of episodes of the task, such as each size of box.
        baseline: add columns for the baselines: the reference alone, and those of the task.
        json: end with one line of JSON: the metrics, and those of the baselines by name under `baselines`.
        report: write tables, every episode, figures and a video into this directory.
        film: number of episodes in that video.
    """

    episodes: int = 512
    per_group: bool = False
    baseline: bool = False
    json: bool = False
    report: Path | None = None
    film: int = 4

    def run(self) -> None:
        """Judge and report."""
        from ppt_rl.evaluation import evaluate
        from ppt_rl.evaluation.drawing import draw_policy, require_filmable

        require_filmable(self.film, "film")
        _check(episodes=self.episodes, seed=self.seed, num_envs=self.num_envs, report=self.report)
        policy = self.load()
        result = evaluate(
            policy, episodes=self.episodes, seed=self.seed, num_envs=self.num_envs, groups=self.per_group,
            baselines=self.baseline,
        )  # fmt: skip
        print(f"{self.policy}: {self.episodes} episodes a column, seed {self.seed}\n\n{result.tables()}")
        if self.report is not None:
            result.write(self.report)
            draw_policy(policy, self.report, episodes=self.film, seed=self.seed)
            print(f"report in {self.report}")
        if self.json:
            print(json.dumps(result.as_json()))


@dataclass(frozen=True)
class Film(Judged):
    """Write a video of a policy, with time, power, tank level and force over it.

    Attributes:
        output: path of the video, .mp4 or .gif; by default VARIANT.mp4.
        episodes: number of episodes, one after the other.
    """

    output: Path | None = None
    episodes: int = 2

    def run(self) -> None:
        """Record and film."""
        from ppt_rl.evaluation.drawing import film, require_filmable
        from ppt_rl.evaluation.video import require_video_path

        require_filmable(self.episodes)
        if self.output is not None:
            require_video_path(self.output, "output")
        folder = None if self.output is None else self.output.parent
        _check(episodes=self.episodes, seed=self.seed, num_envs=self.num_envs, output=folder)
        policy = self.load()
        output = self.output or Path(f"{policy.variant}.mp4")
        print(film(policy, output, episodes=self.episodes, seed=self.seed))


@dataclass(frozen=True)
class CalibrateTank(Judged):
    """Run a policy without the limits of a tank and propose p_max and e_max.

    Attributes:
        episodes: number of fresh episodes.
        quantile: share of the successful episodes that the proposed limits would leave untouched [0-1].
        margin: factor on that quantile, for what the episodes did not show [-].
        json: end with one line of JSON.
        report: write calibration.json and calibration.png into this directory.
    """

    seed: int = 20_000
    episodes: int = 512
    quantile: float = 0.99
    margin: float = 1.1
    json: bool = False
    report: Path | None = None

    def run(self) -> None:
        """Calibrate and report."""
        from ppt_rl.evaluation import calibrate

        _check(episodes=self.episodes, seed=self.seed, num_envs=self.num_envs, report=self.report)
        result = calibrate(
            self.load(), episodes=self.episodes, seed=self.seed, num_envs=self.num_envs, quantile=self.quantile,
            margin=self.margin,
        )  # fmt: skip
        print(result.text())
        if self.report is not None:
            result.write(self.report)
            print(f"report in {self.report}")
        if self.json:
            print(json.dumps(result.as_json()))


@dataclass(frozen=True)
class Study:
    """Train and compare variants of a task over seeds. Run it again to continue it, or with more seeds to add some.

    Attributes:
        recipes: variants, files of recipes, or a task for all of its variants.
        seeds: number of seeds, 0 to seeds - 1.
        episodes: number of evaluated episodes of a run in each group of episodes.
        eval_seed: seed of the evaluated episodes, or several, which share them equally.
        num_envs: number of environments that step together in the evaluation.
        settings: options to change in every recipe, as NAME=VALUE: `--set num_envs=64 ppo.epochs=4`.
        runs: directory of the training runs: logs and checkpoints, some 10 MB each.
        results: directory of the results; by default results/TASK.
        publish: directory where the policies of seed 0 are published; by default none is.
        report_only: train nothing; tables and figures of the runs that are finished.
    """

    recipes: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="RECIPE")] = ("push",)
    seeds: int = 3
    episodes: int = 512
    eval_seed: tuple[int, ...] = (10_000,)
    num_envs: int = 128
    settings: _Settings = ()
    runs: Path = Path("runs/study")
    results: Path | None = None
    publish: Path | None = None
    report_only: bool = False

    def run(self) -> None:
        """Run what is not finished, then report."""
        from ppt_rl import evaluation

        study = evaluation.Study(
            evaluation.find_recipes(self.recipes), seeds=self.seeds, episodes=self.episodes, eval_seed=self.eval_seed,
            num_envs=self.num_envs, settings=_pairs(self.settings), runs=self.runs, results=self.results,
            publish=self.publish,
        )  # fmt: skip
        runs = None if self.report_only else self.runs
        _check(episodes=1, seed=0, results=study.results_dir, runs=runs, publish=self.publish)
        evaluation.run_study(study, report_only=self.report_only)


@dataclass(frozen=True)
class Sweep:
    """Find where policies break: success against the difficulty of the episodes, one quantity at a time.

    Attributes:
        policies: published policies, checkpoints or runs, all of one task.
        episodes: number of episodes at each point.
        seed: seed of the episodes.
        num_threads: physics threads; 0 takes one per CPU.
        baseline: names of baselines to sweep too, with the options of the first policy.
        report: directory of difficulty.json and difficulty.png.
        report_only: run no episode; draw difficulty.png anew from difficulty.json.
    """

    policies: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="POLICY")]
    episodes: int = 64
    seed: int = 30_000
    num_threads: int = 0
    baseline: tuple[str, ...] = ()
    report: Path = Path("runs/difficulty")
    report_only: bool = False

    def run(self) -> None:
        """Sweep and draw."""
        from ppt_rl.evaluation import run_sweep
        from ppt_rl.evaluation.sweep import redraw_sweep

        if not self.policies:
            raise ValueError("no policy is given; expected at least one.")
        _check(episodes=self.episodes, seed=self.seed, report=self.report)
        policies = [_load(name, None, (f"num_threads={self.num_threads}",)) for name in self.policies]
        if self.report_only:
            redraw_sweep(policies[0].recipe.task, self.report)
            return
        run_sweep(policies, episodes=self.episodes, seed=self.seed, baselines=self.baseline, report=self.report)


@dataclass(frozen=True)
class Policies:
    """List the published policies with their figures."""

    def run(self) -> None:
        """Print a table."""
        from ppt_rl.evaluation.published import published_table

        print(published_table())


def _load(name: str, recipe: str | None, settings: tuple[str, ...]) -> Policy:
    """A policy with changed options."""
    from ppt_rl.evaluation import load_policy
    from ppt_rl.training import with_settings

    policy = load_policy(name, recipe=recipe)
    return replace(policy, config=with_settings(policy.config, _pairs(settings)))


def _check(*, episodes: int, seed: int, num_envs: int = 1, **folders: Path | None) -> None:
    """Refuse impossible numbers, and folders where nothing can be written, before anything is loaded."""
    from ppt_rl.evaluation.episodes import require_run_options
    from ppt_rl.evaluation.outputs import require_folder

    require_run_options(episodes=episodes, seed=seed, num_envs=num_envs)
    for option, folder in folders.items():
        if folder is not None:
            require_folder(option, folder)


def _pairs(settings: tuple[str, ...]) -> dict[str, str]:
    """Options by name from ``NAME=VALUE``."""
    bad = [text for text in settings if not all(text.partition("="))]
    if bad:
        raise ValueError(f"--set got {bad}; expected NAME=VALUE, such as p_max=0.5.")
    names = [text.partition("=")[0] for text in settings]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"--set got {twice} more than once; expected one value for each option.")
    return {name: value for name, _, value in (text.partition("=") for text in settings)}
