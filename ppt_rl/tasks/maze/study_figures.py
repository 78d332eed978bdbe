"""Figures that only a study of mazes has: the paper's maze, rollouts in it, and the prior of the movement primitive."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from ppt_rl.envs import paper_layout
from ppt_rl.evaluation.runs import KeptRun
from ppt_rl.evaluation.study_figures import plot_promp
from ppt_rl.tasks.maze.figures import plot_layout, plot_rollouts

__all__ = ["draw_maze_study"]


def draw_maze_study(groups: Mapping[str, Sequence[KeptRun]], directory: Path) -> None:
    """Draw the paper's maze, the first run of each variant in it, and the prior of the movement primitive.

    Args:
        groups: finished runs by label.
        directory: target directory.
    """
    plot_layout(paper_layout(), directory / "paper_maze.png")
    plot_rollouts(
        paper_layout(), {label: runs[0].rollouts() for label, runs in groups.items()}, directory / "rollouts.png"
    )
    for run, *_ in groups.values():
        if run.recipe.has_reference and not (directory / "prior.png").exists():
            config = run.config()
            modules = run.recipe.make_modules(config)
            run.recipe.fit(config, **modules)
            plot_promp(modules["promp"], None, directory / "prior.png", labels=["ahead [m]", "left [m]", "up [m]"])
