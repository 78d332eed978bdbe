from __future__ import annotations

import importlib.util
import urllib.request

import numpy as np
import pytest

from ppt_rl.training.extras import MissingPackage, require_package
from ppt_rl.view import LiveView

needs_viser = pytest.mark.skipif(importlib.util.find_spec("viser") is None, reason="viser, of ppt_rl[view], is missing")


@pytest.fixture
def view(policy):
    view = LiveView(policy, port=18_080, seed=7, real_time=False)
    yield view
    view.close()
    view.episodes.free()


@needs_viser
def test_the_page_is_served_and_episodes_move_the_scene(view):
    assert b"<html" in urllib.request.urlopen(view.url, timeout=20).read().lower()
    view.run(1)
    arm = view._nodes._bodies[view.episodes.base.physics(0).model.ptr.body("link7").id]
    box = view._nodes._bodies[view.episodes.base.physics(0).model.ptr.body("box").id]
    first = np.array(arm.position), np.array(box.position)
    positions = view.episodes.base.physics(0).data.ptr.xpos
    assert np.linalg.norm(positions[view.episodes.base.physics(0).model.ptr.body("link7").id] - first[0]) < 0.02
    view.run(1)  # another episode, which starts with another box
    assert np.linalg.norm(np.array(box.position) - first[1]) > 1e-3
    assert view.frames > 0


@needs_viser
def test_every_visible_shape_is_below_the_node_of_its_body(view):
    view.run(1)
    names = list(view._nodes._shapes)
    assert sum("shell" in name for name in names) == len(view.episodes.base.arm.shells)
    assert {"outline0", "box_face", "plate0", "box", "bar"} <= {name.partition("_")[2] for name in names}
    for shape, handle in view._nodes._shapes.values():
        assert handle.name.startswith(f"/body{shape.body}/")


@needs_viser
def test_a_box_of_another_size_is_drawn_anew_and_what_is_the_same_is_not(policy):
    view = LiveView(policy, port=18_080, seed=7, real_time=False)
    sizes, shells = set(), set()
    for _ in range(8):
        view.run(1)
        for name, (shape, handle) in view._nodes._shapes.items():
            if name.endswith("_box"):
                sizes.add(round(float(np.ptp(shape.vertices[:, 0])), 3))
            if name.endswith("shell3"):
                shells.add(id(handle))
    assert sizes == {0.06, 0.08}
    assert len(shells) == 1
    view.close()
    view.episodes.free()


@needs_viser
def test_sliders_change_the_world_from_the_next_episode_on(view):
    view.sliders["p_max"].value = 0.5
    view.sliders["friction"].value = 0.9
    assert view.episodes.settings == pytest.approx({"p_max": 0.5, "friction": 0.9})
    view.run(1)
    assert view.episodes.present.config.p_max == pytest.approx(0.5)
    assert view._plots._limits["power"] == pytest.approx(0.5)
    assert view.episodes.base.engine.models[0].geom("box").friction[0] == pytest.approx(0.9)


@needs_viser
def test_buttons_pause_and_reset(view):
    view._on_pause(None)
    assert view.episodes.paused
    assert view.pause.label == "go on"
    view._on_pause(None)
    assert not view.episodes.paused
    view.speed.value = 0.5
    assert view.episodes.speed == 0.5


@needs_viser
def test_plots_hold_the_readings_and_their_limits(view):
    view.run(1)
    power = view._plots._plots["power"].data
    assert len(power[0]) == view.episodes.policy.config.horizon
    assert set(power[2]) == {2.0}
    assert np.ptp(power[1]) > 0.1
    assert view._plots._plots["tank_energy"].data[1].max() <= 1.3


@needs_viser
def test_a_port_that_is_taken_is_left_for_the_next_one(view, policy):
    other = LiveView(policy, port=18_080, seed=7, real_time=False)
    assert other.url != view.url
    other.close()
    other.episodes.free()


@pytest.mark.parametrize("port", [0, 70_000, "http"])
def test_an_impossible_port_is_refused(policy, port):
    with pytest.raises(ValueError, match="port is"):
        LiveView(policy, port=port)


def test_a_missing_package_is_named_with_its_remedy(policy, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(MissingPackage, match=r"the live view needs the package viser.*pip install 'ppt_rl\[view\]'"):
        LiveView(policy)
    with pytest.raises(MissingPackage):
        require_package("nothing", "view", "this")
