from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ppt_rl.envs import MazeLayout, Straight, Turn, paper_layout
from ppt_rl.tasks.maze.figures import plot_layout, plot_rollouts


def drawn(path: Path) -> bool:
    return path.exists() and path.stat().st_size > 5_000


@pytest.mark.parametrize(
    "layout", [paper_layout(), MazeLayout((Straight(0.1), Turn(0.4), Straight(0.1)), start=(0.5, -0.1))]
)
def test_a_layout_is_drawn(layout: MazeLayout, tmp_path: Path) -> None:
    plot_layout(layout, tmp_path / "layout.png")
    assert drawn(tmp_path / "layout.png")


@pytest.mark.parametrize("touched", [False, True])
def test_rollouts_are_drawn_with_and_without_via_points(touched: bool, tmp_path: Path) -> None:
    generator = np.random.default_rng(0)
    pose = np.concatenate([generator.uniform(0.3, 0.6, (2, 9, 3)), np.zeros((2, 9, 4))], -1)
    rollout = {"pose": pose, "steps": np.asarray([9, 4])}
    via = {"via_position": pose[:, :, None, :3], "via_mask": np.full((2, 9, 1), touched)}
    plot_rollouts(paper_layout(), {"PPT": rollout | via, "ST": rollout}, tmp_path / "rollouts.png")
    assert drawn(tmp_path / "rollouts.png")


@pytest.mark.parametrize("count", [1, 2, 3])
def test_every_map_has_y_to_the_left_however_many_there_are(count, monkeypatch):
    figures = []
    monkeypatch.setattr("ppt_rl.tasks.maze.figures.save_figure", lambda figure, path: figures.append(figure))
    rollout = {"pose": np.tile([0.4, 0.0, 0.02, 0.0, 1.0, 0.0, 0.0], (1, 5, 1)), "steps": np.asarray([5])}
    plot_rollouts(paper_layout(), {f"variant {number}": rollout for number in range(count)}, Path("never.png"))
    plot_layout(paper_layout(), Path("never.png"))
    for axes in (axes for figure in figures for axes in figure.axes):
        assert axes.get_xlabel() == "y, to the left [m]"
        assert axes.get_xlim()[0] > axes.get_xlim()[1]
        assert axes.get_ylim()[0] < axes.get_ylim()[1]
        assert axes.get_legend() is None
    assert [len(figure.legends) for figure in figures] == [1, 1]
