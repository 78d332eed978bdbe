"""Figures of mazes: layouts from above and from the side, rollouts with via-points from touch."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from tensordict import TensorDictBase

from ppt_rl.envs import MazeEnv, MazeLayout
from ppt_rl.envs.maze.geometry import Corridor, build_corridor
from ppt_rl.evaluation import Policy
from ppt_rl.evaluation.figures import map_axes, one_legend, save_figure
from ppt_rl.evaluation.study_figures import VARIANT_COLORS

__all__ = ["draw_maze_episode", "plot_layout", "plot_rollouts"]

Array = NDArray[np.float64]
_WALL, _FLOOR, _GREY = "#3c4654", "#b9b2a3", "#8a8f98"


def _draw_map(axes: Any, corridor: Corridor) -> None:
    """Walls and centre line from above, as the arm sees them."""
    walls = [np.stack([face.begin, face.end]) for face in corridor.faces]
    for wall in walls:
        axes.plot(wall[:, 1], wall[:, 0], color=_WALL, lw=1.5)
    axes.plot(corridor.centre[:, 1], corridor.centre[:, 0], color=_GREY, ls="--", lw=1, label="centre line")
    x, y = np.concatenate(walls)[:, :2].T
    map_axes(axes, x, y)


def _draw_side(axes: Any, corridor: Corridor, above: Any) -> None:
    """Floor along y, from the side, below the map ``above``."""
    axes.plot(corridor.centre[:, 1], corridor.centre[:, 2], color=_FLOOR, lw=3, label="floor")
    axes.set(xlabel="y, to the left [m]", ylabel="z, up [m]", xlim=above.get_xlim())
    axes.grid(alpha=0.3)


def plot_layout(layout: MazeLayout, path: Path) -> None:
    """Draw a maze from above and from the side.

    Args:
        layout: the maze.
        path: path of the picture.
    """
    corridor = build_corridor(layout)
    figure = Figure(figsize=(8, 5.2), layout="constrained")
    above, side = figure.subplots(2, 1, height_ratios=(2, 1))
    _draw_map(above, corridor)
    above.plot(*corridor.centre[0, [1, 0]], "o", color=VARIANT_COLORS["ST"], label="start")
    above.plot(*corridor.centre[-1, [1, 0]], "s", color=VARIANT_COLORS["PPT"], label="end")
    above.set_title(
        f"{corridor.length:.2f} m long, {1e3 * layout.width:.0f} mm wide, friction {layout.friction:.2f}", fontsize=10
    )
    _draw_side(side, corridor, above)
    one_legend(figure)
    save_figure(figure, path)


def plot_rollouts(layout: MazeLayout, rollouts: Mapping[str, Mapping[str, Array]], path: Path) -> None:
    """Rollouts in one maze by variant, from above and from the side, with the via-points inferred from touch.

    Args:
        layout: the maze.
        rollouts: by variant: ``pose`` (N, T, 7) [m, -], ``steps`` (N,) control steps of each, and, where there are
            any, ``via_position`` (N, T, M, 3) [m] with ``via_mask`` (N, T, M).
        path: path of the picture.
    """
    corridor = build_corridor(layout)
    figure = Figure(figsize=(6.5 * len(rollouts), 5.0), layout="constrained")
    panels = np.asarray(figure.subplots(2, len(rollouts), height_ratios=(1.7, 1))).reshape(2, -1)
    for (above, side), (variant, rollout) in zip(panels.T, rollouts.items(), strict=True):
        _draw_map(above, corridor)
        _draw_side(side, corridor, above)
        color = VARIANT_COLORS.get(variant, _GREY)
        for row, steps in enumerate(rollout["steps"].astype(int)):
            x, y, z = rollout["pose"][row, :steps, :3].T
            above.plot(y, x, color=color, lw=1, alpha=0.7, label=variant)
            side.plot(y, z, color=color, lw=1, alpha=0.7)
        points = _via_points(rollout)
        if len(points):
            above.plot(points[:, 1], points[:, 0], ".", color="black", ms=3, label="via-points from touch")
            side.plot(points[:, 1], points[:, 2], ".", color="black", ms=3)
        above.set_title(f"{variant}: {len(rollout['steps'])} starts; from above and from the side", fontsize=10)
    one_legend(figure)
    save_figure(figure, path)


def _via_points(rollout: Mapping[str, Array]) -> Array:
    """``(N, 3)`` distinct via-points that were in a buffer at any time."""
    if "via_position" not in rollout:
        return np.zeros((0, 3))
    found = [
        rollout["via_position"][row, :steps][rollout["via_mask"][row, :steps].astype(bool)]
        for row, steps in enumerate(rollout["steps"].astype(int))
    ]
    return np.unique(np.concatenate(found).round(5), axis=0)


def draw_maze_episode(policy: Policy, env: MazeEnv, episode: TensorDictBase, path: Path) -> None:
    """Draw one recorded episode of a policy in its maze.

    Args:
        policy: who acted.
        env: the bare environment, not reset since; the episode is that of its first maze.
        episode: what was recorded, without a batch dimension.
        path: path of the picture.
    """
    layout = env.layouts[0]
    assert layout is not None
    arrays = {key: value.numpy()[None] for key, value in episode["trace"].items()}
    rollout = arrays | {"steps": episode["control_steps"].numpy()}
    plot_rollouts(layout, {policy.recipe.label: rollout}, path)
