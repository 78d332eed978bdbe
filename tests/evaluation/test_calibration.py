from __future__ import annotations

import json

import numpy as np
import pytest

from ppt_rl.evaluation import Policy, calibrate, load_policy


@pytest.fixture(scope="module")
def policies() -> dict[str, Policy]:
    """Published policies in short episodes of a coarse physics."""
    short = {"duration": 0.3, "physics_dt": 0.002, "num_threads": 1}
    return {name: load_policy(name).with_changes(**short) for name in ("s_push", "st_push")}


def test_calibration_proposes_limits_that_leave_the_quantile_untouched(policies, tmp_path):
    result = calibrate(policies["st_push"], episodes=8, seed=1, num_envs=4, quantile=0.75)
    assert result.successful == 0  # none can succeed in so short a time, so the proposal is from all
    assert result.proposal()["p_max"] == pytest.approx(1.1 * np.quantile(result.rows["max_power"], 0.75))
    assert result.proposal()["e_max"] == pytest.approx(1.1 * np.quantile(result.rows["work"], 0.75))
    result.write(tmp_path)
    assert (tmp_path / "calibration.png").exists()
    assert json.loads((tmp_path / "calibration.json").read_text())["variant"] == "st_push"
    assert "No episode succeeded" in result.text()
    assert "proposal: --p-max" in result.text()


def test_successful_episodes_alone_decide_where_there_are_any(policies):
    result = calibrate(policies["s_push"], episodes=8, seed=1, num_envs=4, quantile=1.0, margin=1.0)
    result.rows["success"][:2] = 1.0
    assert result.proposal()["p_max"] == pytest.approx(result.rows["max_power"][:2].max())


def test_calibration_removes_the_limits_of_a_tank(policies):
    limited = policies["st_push"].with_changes(p_max=0.01)
    free = calibrate(limited, episodes=4, seed=0, num_envs=4).rows["max_power"].max()
    env = limited.make_env(4, seed=0)
    rollout = env.rollout(100, limited.actor)
    assert float(rollout["next", "metrics", "max_power"].max()) <= 0.01 * (1 + 1e-5) < free


@pytest.mark.parametrize(("name", "value"), [("quantile", 0.0), ("quantile", 1.5), ("margin", 0.5)])
def test_impossible_settings_of_a_calibration_are_refused(policies, name, value):
    with pytest.raises(ValueError, match=name):
        calibrate(policies["s_push"], episodes=2, seed=0, **{name: value})
