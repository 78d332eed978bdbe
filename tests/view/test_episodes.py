from __future__ import annotations

import math
import threading
import time

import numpy as np
import pytest

from ppt_rl import load_policy
from ppt_rl.evaluation import record_episodes
from ppt_rl.view import LiveEpisodes


@pytest.fixture
def live(policy):
    """Episodes as fast as they go, and what they reported."""
    readings = []
    episodes = LiveEpisodes(policy, seed=7, on_step=readings.append, real_time=False)
    yield episodes, readings
    episodes.free()


def test_every_control_step_is_reported_once_and_in_order(live):
    episodes, readings = live
    assert [episodes.run(), episodes.run()] == [False, False]  # 0.3 s are too short
    steps = episodes.policy.config.horizon
    assert [reading.step for reading in readings] == [*range(1, steps + 1)] * 2
    assert [reading.time for reading in readings] == pytest.approx([0.01 * (n + 1) for n in range(2 * steps)])


def test_an_episode_is_that_of_the_policy_without_a_view(live, policy):
    episodes, readings = live
    episodes.run()
    env = policy.make_env(1, seed=7, privileged=True)
    trace = record_episodes(env, policy.actor, ("power", "tank_energy", "wrench"))["trace"][0]
    for name in ("power", "tank_energy"):
        seen = [getattr(reading, name) for reading in readings]
        np.testing.assert_allclose(seen, trace[name][:, 0], rtol=1e-4, atol=1e-4)
    assert max(reading.power for reading in readings) > 0.1
    env.close()


def test_changed_limits_hold_from_the_next_episode_on(live):
    episodes, readings = live
    episodes.run()
    before = max(reading.power for reading in readings)
    assert before > 0.5
    readings.clear()
    episodes.change("p_max", 0.25)
    episodes.change("e_max", 0.1)
    assert episodes.present.config.p_max == 2.0
    episodes.run()
    assert max(abs(reading.power) for reading in readings) <= 0.25 + 1e-5
    assert max(reading.tank_energy for reading in readings) <= 0.1 + 1e-6


def test_a_stiffness_and_a_friction_reach_the_world(live):
    episodes, _ = live
    episodes.change("friction", 0.9)
    episodes.change("stiffness", 100.0)
    episodes.run()
    assert episodes.base.engine.models[0].geom("box").friction[0] == pytest.approx(0.9)
    assert episodes.present.config.stiffness == 100.0


def test_a_reset_gives_up_the_episode_and_the_next_one_is_whole(policy):
    readings = []

    def hear(reading):
        readings.append(reading)
        if len(readings) == 5:
            episodes.restart()

    episodes = LiveEpisodes(policy, seed=7, on_step=hear, real_time=False)
    assert episodes.run() is None
    assert len(readings) == 5
    assert episodes.run() is not None
    assert [reading.step for reading in readings[5:]] == [*range(1, policy.config.horizon + 1)]
    assert readings[5].tank_energy == pytest.approx(policy.config.e_max, abs=0.02)  # filled anew
    episodes.free()


def test_a_pause_holds_the_world_and_a_reset_ends_it(policy):
    readings = []

    def hear(reading):
        readings.append(reading)
        episodes.paused = reading.step == 3

    episodes = LiveEpisodes(policy, seed=7, on_step=hear, real_time=False)
    result = []
    thread = threading.Thread(target=lambda: result.append(episodes.run()))
    thread.start()
    while len(readings) < 3:
        time.sleep(0.01)
    time.sleep(0.2)
    assert len(readings) == 3
    assert thread.is_alive()
    episodes.restart()
    thread.join(20)
    assert result == [None]
    episodes.free()


def test_closed_episodes_do_not_run(live):
    episodes, readings = live
    episodes.close()
    assert episodes.run() is None
    assert not readings


def test_the_obstacle_follows_no_faster_than_it_may_and_stays_for_the_next_episode(policy):
    places = []
    episodes = LiveEpisodes(
        policy, seed=7, on_step=lambda _: places.append(episodes.base.obstacle_place), real_time=False
    )
    start = episodes.obstacle
    assert places == []
    episodes.obstacle = (start[0], start[1] - 0.10)
    episodes.run()
    moved = np.linalg.norm(np.diff(np.asarray(places), axis=0), axis=-1)
    assert moved.max() <= 0.4 * 0.01 + 1e-6
    assert places[-1] == pytest.approx(episodes.obstacle, abs=1e-6)
    assert tuple(episodes.base.engine.models[0].body("plate0").pos[:2]) == pytest.approx(episodes.obstacle, abs=1e-6)
    episodes.change("p_max", 1.0)  # another environment
    episodes.run()
    assert episodes.base.obstacle_place == pytest.approx(episodes.obstacle, abs=1e-6)
    episodes.free()


def test_an_obstacle_in_the_way_stops_the_tool():
    policy = load_policy("ppt_push").with_changes(num_threads=1)
    ahead, forces = [], []
    for place in (None, (0.40, 0.0)):
        seen = []
        episodes = LiveEpisodes(policy, seed=7, on_step=seen.append, real_time=False)
        if place is not None:
            episodes.obstacle = place
            episodes.base.move_obstacle(place)
        episodes.run()
        ahead.append(float(episodes.base.physics(0).data.ptr.site("end_effector").xpos[0]))
        forces.append(max(reading.force for reading in seen))
        episodes.free()
    assert forces[1] > 3 * forces[0]
    assert ahead[1] < ahead[0]


def test_a_policy_without_tank_or_obstacle_is_shown_too():
    policy = load_policy("st_maze").with_changes(num_threads=1, duration=0.2)
    seen = []
    episodes = LiveEpisodes(policy, seed=0, on_step=seen.append, real_time=False)
    assert not episodes.has_obstacle
    episodes.run()
    assert len(seen) == 20
    episodes.free()
    seen.clear()
    episodes = LiveEpisodes(
        load_policy("pp_push").with_changes(num_threads=1, duration=0.2), seed=0, on_step=seen.append, real_time=False
    )
    episodes.run()
    assert math.isnan(seen[0].tank_energy)
    assert not math.isnan(seen[0].power)
    episodes.free()
