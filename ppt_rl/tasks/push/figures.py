"""One pushing episode: the scene from above, and power, tank level and valve over time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from numpy.typing import NDArray
from tensordict import TensorDictBase

from ppt_rl.envs import PushEnv
from ppt_rl.evaluation import Policy
from ppt_rl.evaluation.figures import map_axes, one_legend, save_figure

__all__ = ["draw_push_episode", "plot_push_episode"]

_BLUE, _ORANGE, _GREEN = "#1f5fa8", "#d9701a", "#2a9d4a"
Array = NDArray[np.float64]


def draw_push_episode(policy: Policy, env: PushEnv, episode: TensorDictBase, path: Path) -> None:
    """Draw one recorded episode of a policy.

    Args:
        policy: who acted.
        env: the bare environment.
        episode: what was recorded, without a batch dimension.
        path: path of the picture.
    """
    arrays = {key: value.double().numpy() for key, value in episode["trace"].items()}
    known = ("goal", "box_size", "via_position", *(["goal_yaw"] if "goal_yaw" in episode.keys() else []))
    arrays |= {key: episode[key].double().numpy() for key in known}
    config = policy.config
    e_max = config.e_max if policy.recipe.has_tank else None
    plot_push_episode(arrays, path, p_max=config.p_max, e_max=e_max, dt=config.control_dt)


def plot_push_episode(
    episode: Mapping[str, Array], path: Path, *, p_max: float, dt: float, e_max: float | None = None
) -> None:
    """One pushing episode: the scene from above, and power, tank level and valve over time.

    Args:
        episode: arrays over T control steps: ``pose`` (T, 7), ``box_pose`` (T, 7), ``power`` (T, 1), and where there is
            a tank ``tank_energy`` (T, 1) and ``valve`` (T, 1); and ``goal`` (2,), ``box_size`` (1,), ``via_position``
            (M, 3), and where the goal has one ``goal_yaw`` (1,).
        path: path of the picture.
        p_max: power limit [W].
        e_max: tank capacity [J]; None where there is no tank.
        dt: control step [s].
    """
    rows = [("power", "power [W]", p_max)]
    if e_max is not None:
        rows += [("tank_energy", "tank level [J]", e_max), ("valve", "valve [-]", 1.0)]
    figure = Figure(figsize=(11, 5.6), layout="constrained")
    grid = figure.add_gridspec(len(rows), 2, width_ratios=(1.1, 1))
    _draw_scene(figure.add_subplot(grid[:, 0]), episode)
    time = dt * np.arange(1, len(episode["power"]) + 1)
    for row, (key, label, limit) in enumerate(rows):
        values = episode[key]
        axes = figure.add_subplot(grid[row, 1])
        axes.axhline(limit, color="black", ls="--", lw=1.0, label="limit of power, capacity, valve open")
        axes.plot(time, values[:, 0], color=_BLUE, lw=1.8)
        axes.set_ylabel(label)
        axes.set_ylim(1.1 * min(0.0, float(values.min())) - 0.04 * limit, 1.12 * max(limit, float(values.max())))
        axes.grid(alpha=0.3)
        if row < len(rows) - 1:
            axes.tick_params(labelbottom=False)
        else:
            axes.set_xlabel("time [s]")
    one_legend(figure)
    save_figure(figure, path)


def _draw_scene(axes: Axes, episode: Mapping[str, Array]) -> None:
    """The table from above, as the arm sees it."""
    tool, box, half = episode["pose"], episode["box_pose"], 0.5 * float(episode["box_size"][0])
    corners = half * np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
    drawn = [episode["goal"] + 1.5 * corners]
    for step in np.linspace(0, len(tool) - 1, 7).astype(int):
        alpha = 0.25 + 0.75 * step / len(tool)
        outline = _placed(corners, box[step])
        axes.add_patch(Polygon(outline[:, ::-1], closed=True, fill=False, ec=_ORANGE, lw=1.5, alpha=alpha))
        axes.plot(*outline[:2, ::-1].T, color=_ORANGE, lw=3.5, alpha=alpha, solid_capstyle="butt")
        bar = _placed(np.array([[0.0, -0.06], [0.0, 0.06]]), tool[step], tool_down=True)
        axes.plot(bar[:, 1], bar[:, 0], color=_BLUE, lw=2.5, alpha=alpha, solid_capstyle="round")
        drawn += [outline, bar]
    axes.plot(tool[:, 1], tool[:, 0], color=_BLUE, lw=1, label="tool")
    axes.plot(box[:, 1], box[:, 0], color=_ORANGE, lw=1, label="box (wide: its painted face)")
    if "goal_yaw" in episode:
        yaw = float(episode["goal_yaw"][0])
        turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        outline = (corners @ turn.T + episode["goal"])[:, ::-1]
        axes.add_patch(Polygon(outline, closed=True, fill=False, ec=_GREEN, lw=1.5, ls="--", label="pose of the goal"))
    via = episode["via_position"]
    axes.plot(via[:, 1], via[:, 0], "x", color="black", ms=8, mew=2, label="via-points")
    axes.add_patch(Circle(tuple(episode["goal"][::-1]), 0.02, color=_GREEN, alpha=0.5, lw=0, label="goal, 2 cm"))
    x, y = np.concatenate(drawn).T
    map_axes(axes, x, y)
    axes.grid(alpha=0.3)


def _placed(points: Array, pose: Array, *, tool_down: bool = False) -> Array:
    """Points of a body, in the plane, at a pose. With the tool down, the y axis is reversed."""
    w, x, y, z = pose[3:]
    axis_x = np.array([1 - 2 * (y * y + z * z), 2 * (x * y + w * z)])
    axis_y = np.array([2 * (x * y - w * z), 1 - 2 * (x * x + z * z)])
    if tool_down:
        axis_y = -axis_y
    return pose[:2] + points[:, :1] * axis_x + points[:, 1:] * axis_y
