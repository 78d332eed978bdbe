"""A published policy does as well on one engine as on the other, in the same episodes."""

from __future__ import annotations

import numpy as np
import pytest

from ppt_rl.evaluation import load_policy
from ppt_rl.evaluation.episodes import run_episodes
from ppt_rl.evaluation.statistics import interval

EPISODES = 64


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ppt_push", "st_push"])
def test_a_published_policy_pushes_as_well_on_both_engines(name: str):
    """Contact makes single episodes differ, more so with a policy that acts at each step, but not what comes of it."""
    pytest.importorskip("mujoco_warp", reason="MuJoCo Warp is not installed: pip install 'ppt_rl[gpu]'")
    rows = []
    for engine in ("threads", "warp"):
        policy = load_policy(name).with_changes(engine=engine)
        env = policy.make_env(EPISODES, seed=50_000)
        rows.append(run_episodes(env, policy.actor, EPISODES, keys=["box_size"]))
    np.testing.assert_array_equal(rows[0]["box_size"], rows[1]["box_size"])
    assert np.median(np.abs(rows[0]["progress"] - rows[1]["progress"])) < 0.01
    for found, other in (rows, rows[::-1]):
        low, high = interval(other["success"], is_rate=True)
        assert low <= found["success"].mean() <= high
        assert found["max_power"].max() <= 2.0 * (1 + 1e-5)
