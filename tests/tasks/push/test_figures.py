from __future__ import annotations

import numpy as np

from ppt_rl.tasks.push.figures import plot_push_episode


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
