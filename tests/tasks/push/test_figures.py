from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure

from ppt_rl.tasks.push.figures import _draw_scene, plot_push_episode


def test_an_episode_is_drawn_from_its_traces(tmp_path):
    steps = 30
    pose = np.tile([0.4, 0.0, 0.02, 0.0, 1.0, 0.0, 0.0], (steps, 1))
    box = np.tile([0.45, 0.0, 0.03, 1.0, 0.0, 0.0, 0.0], (steps, 1))
    column = np.linspace(0, 1, steps)[:, None]
    episode = {
        "pose": pose, "box_pose": box, "power": column, "tank_energy": 3 - column, "valve": np.ones_like(column),
        "goal": np.array([0.6, 0.1]), "box_size": np.array([0.06]), "via_position": np.zeros((3, 3)),
    }  # fmt: skip
    plot_push_episode(episode, tmp_path / "episode.png", p_max=2.0, e_max=3.0, dt=0.01)
    assert (tmp_path / "episode.png").stat().st_size > 10_000


def test_the_yaw_of_a_goal_is_drawn_as_an_outline_of_the_box():
    pose = np.tile([0.4, 0.0, 0.02, 0.0, 1.0, 0.0, 0.0], (9, 1))
    box = np.tile([0.45, 0.0, 0.03, 1.0, 0.0, 0.0, 0.0], (9, 1))
    episode = {
        "pose": pose, "box_pose": box, "goal": np.array([0.6, 0.1]), "box_size": np.array([0.06]),
        "via_position": np.zeros((3, 3)),
    }  # fmt: skip
    axes = Figure().add_subplot()
    _draw_scene(axes, episode | {"goal_yaw": np.array([0.5])})
    (outline,) = (patch for patch in axes.patches if patch.get_label() == "pose of the goal")
    corners = outline.get_xy()[:4]  # y along the horizontal axis, x along the vertical one
    np.testing.assert_allclose(corners.mean(0), [0.1, 0.6])
    edge = corners[1] - corners[2]
    assert np.arctan2(edge[0], edge[1]) == pytest.approx(0.5)
    right, left = axes.get_xlim()[::-1]
    assert right < 0.1 < left  # y points to the left, as the arm sees it
    assert axes.get_ylim()[0] < 0.45 < axes.get_ylim()[1]
    _draw_scene(without := Figure().add_subplot(), episode)
    assert "pose of the goal" not in [patch.get_label() for patch in without.patches]
