"""Compare the variants of a task over seeds: train, evaluate, tables and figures.

``python recipes/study.py --task push --seeds 3`` goes on where it was stopped: finished runs are not repeated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import torch
from registry import load_policy, recipe_of
from study_maze import save_maze_run, write_maze_report
from study_report import write_report
from study_runs import Run, publish, save_run

from ppt_rl.training import run_cli

#: Variants of each task, in the order in which a seed trains them.
VARIANTS = {"push": ("ppt_push", "pp_push", "st_push", "s_push"), "maze": ("ppt_maze", "st_maze")}
#: What each task keeps of a run, and how it reports.
_SAVE = {"push": save_run, "maze": save_maze_run}
_REPORT = {"push": write_report, "maze": write_maze_report}


@dataclass(frozen=True)
class Config:
    """Train and compare the variants of a task over seeds. Run it again to go on, or with more seeds to add some.

    Attributes:
        task: which task.
        seeds: number of seeds, 0 to seeds - 1.
        variants: only these; by default all of the task.
        runs: where the training runs go: logs and checkpoints, some 10 MB each.
        results: where results go: by default results/TASK.
        pretrained: where the policies of seed 0 are published; by default nowhere.
        report_only: train nothing; tables and figures of the runs that are finished.
        episodes: evaluated episodes of a run, for each box or in as many mazes.
        eval_seed: of the evaluated episodes; training uses small seeds.
        num_envs: environments that step together; by default the recipe's own.
        num_threads: physics threads; 0 takes one per CPU.
        total_control_steps: training budget of a run [control steps]; by default the recipe's own.
        duration: episode length [s]; by default the recipe's own.
        physics_dt: time step of the physics [s].
    """

    task: Literal["push", "maze"] = "push"
    seeds: int = 3
    variants: tuple[str, ...] = ()
    runs: Path = Path("runs/study")
    results: Path | None = None
    pretrained: Path | None = None
    report_only: bool = False
    episodes: int = 512
    eval_seed: int = 10_000
    num_envs: int | None = None
    num_threads: int = 0
    total_control_steps: int | None = None
    duration: float | None = None
    physics_dt: float = 0.0005

    def __post_init__(self) -> None:
        """Refuse impossible settings."""
        if self.seeds < 1:
            raise ValueError(f"seeds is {self.seeds}; expected at least 1.")
        unknown = set(self.variants) - set(VARIANTS[self.task])
        if unknown:
            raise ValueError(f"variants {sorted(unknown)} are unknown; expected some of {VARIANTS[self.task]}.")

    @property
    def results_dir(self) -> Path:
        """Where results go."""
        return self.results or Path("results") / self.task

    def planned(self) -> list[Run]:
        """All runs, seed by seed, so that a study cut off early still compares like with like."""
        variants = self.variants or VARIANTS[self.task]
        return [
            Run(variant, seed, self.runs / f"{variant}-seed{seed}", self.results_dir / "runs" / f"{variant}-seed{seed}")
            for seed in range(self.seeds)
            for variant in variants
        ]


def recipe_config(study: Config, run: Run) -> Any:
    """Options of a run: the recipe's defaults but for what the study sets."""
    config = recipe_of(run.variant).Config()
    if study.duration is not None and hasattr(config, "training_duration"):
        config = replace(config, training_duration=study.duration)
    return replace(
        config,
        run_dir=run.run_dir,
        seed=run.seed,
        resume=(run.run_dir / "checkpoints").exists(),
        num_envs=study.num_envs or config.num_envs,
        num_threads=study.num_threads,
        duration=study.duration or config.duration,
        physics_dt=study.physics_dt,
        ppo=replace(config.ppo, total_control_steps=study.total_control_steps or config.ppo.total_control_steps),
    )


def train_and_evaluate(study: Config, run: Run) -> None:
    """Train a run to its budget, on from its last checkpoint, evaluate it and keep what others can recompute from."""
    policy = load_policy(recipe_of(run.variant).main(recipe_config(study, run)))
    _SAVE[study.task](run, policy, episodes=study.episodes, seed=study.eval_seed, num_threads=study.num_threads)


def main(study: Config) -> None:
    """Run what is not finished, then report."""
    planned = study.planned()
    for number, run in enumerate(planned, start=1):
        if study.report_only or run.finished:
            continue
        print(f"run {number} of {len(planned)}: {run.variant}, seed {run.seed}")
        train_and_evaluate(study, run)
    finished = [run for run in planned if run.finished]
    if not finished:
        raise ValueError(f"no finished run under {study.results_dir / 'runs'}; leave --report-only out to train some.")
    _REPORT[study.task](study.results_dir, finished)
    for run in finished:
        if study.pretrained is not None and run.seed == 0 and (run.run_dir / "checkpoints").exists():
            publish(run, load_policy(run.run_dir), study.pretrained / run.variant)
    print(f"{len(finished)} of {len(planned)} runs; tables and figures in {study.results_dir}")


if __name__ == "__main__":
    torch.manual_seed(0)
    run_cli(main, Config)
