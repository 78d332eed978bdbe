from __future__ import annotations

import pytest

from ppt_rl import load_policy
from ppt_rl.view import changed_policy, settings_of


def test_a_policy_behind_a_tank_has_its_limits_stiffness_and_friction(policy):
    assert [setting.name for setting in settings_of(policy)] == ["p_max", "e_max", "stiffness", "friction"]
    for setting in settings_of(policy):
        assert setting.low <= setting.value <= setting.high


@pytest.mark.parametrize(
    ("name", "expected"), [("pp_push", ["stiffness", "friction"]), ("st_maze", ["p_max", "e_max"])]
)
def test_settings_that_a_policy_lacks_are_left_out(name, expected):
    found = [setting.name for setting in settings_of(load_policy(name))]
    assert [setting for setting in found if setting in expected] == expected
    assert ("friction" in found) == (name == "pp_push")


def test_changed_settings_are_options_of_the_recipe(policy):
    changed = changed_policy(policy, {"p_max": 0.5, "friction": 0.9}).config
    assert changed.p_max == 0.5
    assert changed.randomisation.friction == (0.9, 0.9)
    assert changed.stiffness == policy.config.stiffness
    assert changed_policy(policy, {}) is policy


@pytest.mark.parametrize(("values", "message"), [({"mass": 1.0}, "'mass' is unknown"), ({"p_max": -1.0}, "p_max")])
def test_impossible_settings_are_refused(policy, values, message):
    with pytest.raises(ValueError, match=message):
        changed_policy(policy, values)
