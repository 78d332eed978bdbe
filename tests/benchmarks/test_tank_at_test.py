"""A policy behind a tank that it never met."""

from __future__ import annotations

import json

import pytest
import tank_at_test
import torch

from ppt_rl import load_policy


def test_the_policy_is_the_same_and_its_chain_has_the_tank():
    without, behind = load_policy("pp_push"), load_policy("ppt_push")
    tanked = tank_at_test.with_tank(without, behind).with_changes(num_threads=1, physics_dt=0.002, e_max=0.3)
    env = tanked.make_env(4, seed=0)
    names = [type(part).__name__ for part in env.transform]
    assert names.count("EnergyTankTransform") == 2
    root = env.reset()
    free = without.with_changes(num_threads=1, physics_dt=0.002).make_env(4, seed=0)
    with torch.no_grad():
        acted = tanked.actor(root)
        assert torch.equal(acted["loc"], without.actor(free.reset())["loc"])
        after = env.step(acted)["next"]
    assert (after["metrics", "work"] <= 0.3 * (1 + 1e-5)).all()
    assert (after["tank_energy"] < 0.01).all()


@pytest.mark.slow
def test_the_points_are_written_and_drawn(tmp_path, monkeypatch):
    monkeypatch.setattr(tank_at_test, "_E_MAX", (0.5,))
    monkeypatch.setattr(tank_at_test, "_P_MAX", (1.0,))
    tank_at_test.main(tank_at_test.Options(episodes=4, report=tmp_path))
    points = json.loads((tmp_path / "tank_at_test.json").read_text())["points"]
    assert [point["actor"] for point in points] == ["PPT", "PP, tank added at test", "reference alone"] * 2
    assert all(point["largest_work"] <= point["e_max"] * (1 + 1e-5) for point in points)
    assert (tmp_path / "tank_at_test.png").exists()
