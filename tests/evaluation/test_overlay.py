from __future__ import annotations

import numpy as np
import pytest

from ppt_rl.evaluation.overlay import Gauge, Overlay, gauges_of

GREY = np.full((480, 640, 3), 120, dtype=np.uint8)
STEPS = 10


def trace():
    ramp = np.linspace(0, 1, STEPS)[:, None]
    return {"power": 2 * ramp, "tank_energy": 1.3 * (1 - ramp), "wrench": np.tile(3 * ramp, (1, 6))}


def coloured(picture, colour):
    """How many pixels have exactly this colour."""
    return int((picture == [int(colour[place : place + 2], 16) for place in (1, 3, 5)]).all(-1).sum())


def test_a_policy_without_a_tank_has_no_gauge_of_one_and_no_limit_of_power():
    gauges = gauges_of(trace(), p_max=None, e_max=None, top_force=4.0)
    assert [gauge.label for gauge in gauges] == ["power", "force"]
    assert not gauges[0].limit
    assert gauges[0].full == 2.0


def test_the_force_is_the_size_of_the_three_first_components():
    force = gauges_of(trace(), p_max=2.0, e_max=1.3, top_force=4.0)[-1]
    np.testing.assert_allclose(force.values, 3 * np.sqrt(3) * np.linspace(0, 1, STEPS))


@pytest.mark.parametrize("label", ["power", "tank", "force"])
def test_the_length_of_a_bar_follows_its_value(label):
    gauges = gauges_of(trace(), p_max=2.0, e_max=1.3, top_force=3 * np.sqrt(3))
    (gauge,) = (gauge for gauge in gauges if gauge.label == label)
    pixels = [coloured(Overlay(gauges, dt=0.01).on(GREY, step), gauge.colour) for step in range(STEPS)]
    assert max(pixels) > 0.9 * 76 * 13  # the inside of the frame
    expected = np.asarray(gauge.values) / gauge.full
    np.testing.assert_allclose(np.asarray(pixels) / max(pixels), expected, atol=0.05)


def test_a_bar_beyond_its_limit_stays_in_its_frame():
    near, far = (Overlay([Gauge("power", "W", np.asarray([v]), 2.0, "#3d9be0")], 0.01).on(GREY, 0) for v in (2.0, 9.0))
    assert coloured(near, "#3d9be0") == coloured(far, "#3d9be0")


def test_nothing_but_the_upper_right_corner_is_written_over_and_the_picture_itself_is_kept():
    before = GREY.copy()
    written = Overlay(gauges_of(trace(), p_max=2.0, e_max=1.3, top_force=4.0), 0.01, ("success", True)).on(
        GREY, 9, last=True
    )
    changed = np.argwhere((written != GREY).any(-1))
    assert changed[:, 0].max() < 130
    assert changed[:, 1].min() > 370
    assert np.array_equal(GREY, before)


def test_the_outcome_is_said_at_the_end_only_and_in_its_colour():
    good, bad = (Overlay([], 0.01, outcome) for outcome in (("success", True), ("missed", False)))
    assert coloured(good.on(GREY, 3), "#4fc06b") == 0
    assert coloured(good.on(GREY, 3, last=True), "#4fc06b") > 20
    assert coloured(bad.on(GREY, 3, last=True), "#e0564b") > 20


def test_text_grows_with_the_picture():
    small, large = (np.zeros((height, 2 * height, 3), np.uint8) for height in (240, 960))
    ink = [int((Overlay([], 0.01).on(picture, 0) > 200).sum()) for picture in (small, large)]
    assert ink[1] > 8 * ink[0] > 0
