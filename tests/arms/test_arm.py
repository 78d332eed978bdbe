from __future__ import annotations

import ast
import re
import sys
from dataclasses import replace

import pytest

import ppt_rl.arms
from ppt_rl.arms import FR3, PANDA, UR5E, Inertial, Limits, Shell, arm_names, find_arm

ARMS = [find_arm(name) for name in arm_names()]


# -- what an arm refuses -----------------------------------------------------------------------------------------------


def joints_with(**changes):
    return {"joints": replace(PANDA.joints, **changes)}


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"home": PANDA.home[:6]}, r"panda has a chain of 7 joints, but .*'home': 6.*expected 7 of each"),
        ({"links": PANDA.links[:6]}, r"panda has a chain of 7 joints, but .*'links': 6.*expected 7 of each"),
        ({"joints": UR5E.joints}, r"panda has a chain of 7 joints, but .*'joints': 6.*expected 7 of each"),
        ({"home": (0.0, 2.0, *PANDA.home[2:])}, "home of joint 2 is 2.0 rad; expected -1.7628 to 1.7628 rad"),
        ({"links": (PANDA.links[0]._replace(mass=0.0), *PANDA.links[1:])}, r"mass of the links: \(0.0, .*above 0"),
        (
            {"links": (Inertial(1.0, (0.0, 0.0, 0.0), (1.0, -1.0, 1.0, 0.0, 0.0, 0.0)), *PANDA.links[1:])},
            r"diagonal inertia of the links: \(1.0, -1.0, .*above 0",
        ),
        ({"apparent_inertia": (8.0, 5.0, 9.0, 1.0, float("nan"), 0.1)}, "apparent_inertia: .*nan.*finite"),
        ({"reach": Limits(0.7, 0.3)}, r"reach is \(0.7, 0.3\); expected 0 < low < high"),
        (
            {"shells": (Shell(8, "cylinder", (1.0,) * 4, 0.1, (0.0,) * 3, (0.0, 0.0, 0.1)),)},
            r"shells belong to the links \[8\]; expected 0 \(the base\) to 7",
        ),
    ],
)
def test_an_arm_whose_parts_do_not_fit_is_refused(changes, match):
    with pytest.raises(ValueError, match=match):
        replace(PANDA, **changes)


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"torque_limits": (87.0,) * 6}, r"lengths \{.*'torque_limits': 6.*\}; expected one entry for each joint"),
        (
            {"position_limits": (Limits(1.0, -1.0), *PANDA.joints.position_limits[1:])},
            r"position_limits of joint 1 are \(1.0, -1.0\); expected low < high",
        ),
        ({"velocity_limits": (0.0,) * 7}, "velocity_limits: .*above 0"),
        ({"torque_limits": (-87.0,) * 7}, "torque_limits: .*above 0"),
        ({"inertia": (float("inf"),) * 7}, "inertia: .*finite"),
        ({"armature": (-0.1,) * 7}, "armature is .* expected numbers of at least 0"),
    ],
)
def test_joints_with_impossible_numbers_are_refused(changes, match):
    with pytest.raises(ValueError, match=match):
        joints_with(**changes)


# -- the arms of the library -------------------------------------------------------------------------------------------


def test_the_fr3_has_the_kinematics_of_the_panda_and_other_limits():
    assert FR3.chain == PANDA.chain
    assert FR3.joints.torque_limits == PANDA.joints.torque_limits
    for name in ("position_limits", "velocity_limits"):
        assert getattr(FR3.joints, name) != getattr(PANDA.joints, name)


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_every_link_and_the_base_can_be_seen(arm):
    assert {shell.link for shell in arm.shells} == set(range(arm.num_joints + 1))


@pytest.mark.parametrize("arm", [PANDA, FR3, UR5E], ids=lambda arm: arm.name)
def test_an_arm_is_found_by_its_name(arm):
    assert find_arm(arm.name) is arm
    assert arm.name in arm_names()


def test_an_unknown_arm_is_answered_with_the_names_of_all():
    with pytest.raises(ValueError, match=rf"arm 'puma' is unknown; expected one of {re.escape(str(arm_names()))}"):
        find_arm("puma")


def test_an_arm_in_a_new_file_of_the_package_is_found(tmp_path, monkeypatch):
    (tmp_path / "longer.py").write_text(
        "from dataclasses import replace\nfrom ppt_rl.arms.ur5e import UR5E\nLONGER = replace(UR5E, name='longer')\n"
    )
    monkeypatch.setattr(ppt_rl.arms, "__path__", [*ppt_rl.arms.__path__, str(tmp_path)])
    try:
        assert find_arm("longer") == replace(UR5E, name="longer")
    finally:
        sys.modules.pop("ppt_rl.arms.longer", None)


def test_no_other_file_of_the_library_names_an_arm_or_its_last_link(root):
    words = {arm.name for arm in ARMS} - {"panda"}  # the Panda is the default in several places
    words |= {f"{name}{arm.num_joints}" for arm in ARMS for name in ("link", "joint", "joint_position")}
    files = [path for path in (root / "ppt_rl").rglob("*.py") if path.parent.name != "arms"]
    assert files
    for path in files:
        constants = {node.value for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Constant)}
        assert not constants & words, path
