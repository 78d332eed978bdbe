"""Bad arguments of modules and of arms as data."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn

from ppt_rl.arms import PANDA, Chain, DHRow, Limits, Offset, find_arm
from ppt_rl.functional import PIDGains
from ppt_rl.modules import (
    CartesianImpedanceController,
    Kinematics,
    Mirror,
    PIDMultiplier,
    ProMP,
    TaskSpace,
    make_actor,
    make_critic,
)
from ppt_rl.modules.actor_critic import update_input_norm
from tests.bad_inputs.entry import BadInput, bad, each

__all__ = ["ENTRIES"]

_POSITIVE, _WHOLE = "{name} is {value}; expected a finite number above 0", "{name} is {value}; expected a whole number"
_PROMP = ProMP(4, 2, 1.0)
_SPACE = TaskSpace(("x", "yaw"), (0.4, 0.0, 0.1, 0.0, 1.0, 0.0, 0.0))
_ARM = Kinematics(PANDA, 0.1)
_VIA = {"via_phase": torch.rand(2, 3), "via_position": torch.zeros(2, 3, 2), "via_cov": torch.zeros(2, 3, 2, 2)}
_ORIGIN = (0.4, 0.0, 0.1, 0.0, 1.0, 0.0, 0.0)


def _posterior(match: str, **changes: object) -> BadInput:
    return bad(_PROMP.posterior, match, **{**_VIA, **changes})


def _changed(part: Any, match: str, changes: dict[str, Any]) -> BadInput:
    entry = bad(lambda **values: replace(part, **values), match, **changes)
    return BadInput(f"{type(part).__name__}({', '.join(changes)}): {match}", entry.make, match)


def _arm(match: str, **changes: object) -> BadInput:
    return _changed(PANDA, match, changes)


def _joints(match: str, **changes: object) -> BadInput:
    return _changed(PANDA.joints, match, changes)


_MULTIPLIER = [
    *each(
        PIDMultiplier, "limit", (-1.0, math.nan, math.inf, "tight", None), "{name} is {value}; expected a finite number"
    ),
    *each(PIDMultiplier, "initial", (-1.0, 101.0, math.nan, "much"), "{name} is {value}; expected a", 1.0),
    bad(PIDMultiplier, "gains is 0.5, of type float; expected PIDGains", 1.0, 0.5),
    bad(PIDMultiplier(1.0, PIDGains()).update, "cost holds 1 NaN", torch.tensor(math.inf)),
]
_PRIMITIVE = [
    *each(ProMP, "num_basis", (0, 1, 3.5, "8", None, [4], 10**9), _WHOLE, num_dof=2, duration=1.0),
    *each(ProMP, "num_dof", (0, -1, 2.5, 10**9, "xy"), _WHOLE, num_basis=4, duration=1.0),
    *each(ProMP, "duration", (0.0, -1.0, math.nan, math.inf, "long", None, True), _POSITIVE, num_basis=4, num_dof=2),
    *each(ProMP, "overlap", (0.0, math.nan, "wide"), _POSITIVE, num_basis=4, num_dof=2, duration=1.0),
    bad(ProMP, "num_basis is 1000 and num_dof 100; expected at most 5000 weights", 1000, 100, 1.0),
    bad(ProMP, r"centres is \[0, 1\]; expected 4 finite numbers", 4, 2, 1.0, centres=[0, 1]),
    bad(ProMP, "centres is .*nan", 4, 2, 1.0, centres=torch.full((4,), math.nan)),
    bad(ProMP, r"widths are \[0.0, .*; expected positive numbers", 4, 2, 1.0, widths=torch.zeros(4)),
    bad(ProMP, "widths is 'wide'; expected 4 finite numbers", 4, 2, 1.0, widths="wide"),
    bad(_PROMP.decode, r"weights has shape \(2, 4\); expected \(\*batch, 4, 2\)", torch.zeros(2, 4), torch.rand(5)),
    bad(_PROMP.decode, r"weights has shape \(8,\)", torch.zeros(8), torch.rand(5)),
    bad(_PROMP.decode, "weights is None, of type NoneType; expected Tensor", None, torch.rand(5)),
    bad(_PROMP.decode, "phase is 0.5, of type float; expected Tensor", torch.zeros(4, 2), 0.5),
    *each(_PROMP.sample, "num_samples", (0, -3, 2.5, 10**12), _WHOLE),
    bad(_PROMP.fit, "demonstrations is 3, of type int; expected Tensor or Sequence", 3),
    bad(_PROMP.fit, "got 1 demonstrations; expected at least 2", torch.zeros(1, 9, 2)),
    bad(_PROMP.fit, r"demonstration has shape \(9, 3\); expected \(\*batch, 2\)", torch.zeros(3, 9, 3)),
    bad(_PROMP.fit, r"demonstration has shape \(1, 2\); expected \(T >= 2, D\)", torch.zeros(3, 1, 2)),
    bad(_PROMP.fit, "demonstration holds 18 NaN", torch.full((3, 9, 2), math.nan)),
    bad(_PROMP.fit, r"demonstration is \[1, 2\], of type list", [[1, 2], [3, 4]]),
    *each(_PROMP.fit, "ridge", (0.0, -1.0, math.nan, None), _POSITIVE, torch.rand(3, 9, 2)),
    _posterior(r"via_phase \(2, 3\), via_position \(2, 4, 2\)", via_position=torch.zeros(2, 4, 2)),
    _posterior(r"via_cov \(2, 3, 2\); expected .*\(\*B, 3, 2, 2\)", via_cov=torch.zeros(2, 3, 2)),
    _posterior(r"via-points are empty \(M = 0\); expected at least one slot", via_phase=torch.zeros(2, 0)),
    _posterior("via_phase is 0.5, of type float", via_phase=0.5),
    _posterior("via-point phases holds 6 NaN", via_phase=torch.full((2, 3), math.nan)),
    _posterior("via-points holds 12 NaN", via_position=torch.full((2, 3, 2), math.inf)),
    _posterior("not positive semi-definite; expected", via_cov=-torch.eye(2).expand(2, 3, 2, 2)),
    _posterior(r"via_mask is of torch.float32; expected torch.bool", via_mask=torch.ones(2, 3)),
    _posterior(r"via_mask has shape \(2, 2\); expected \(\*batch, 3\)", via_mask=torch.ones(2, 2).bool()),
    _posterior("via_velocity came without via_velocity_cov; pass", via_velocity=torch.zeros(2, 3, 2)),
    _posterior(
        r"via_velocity \(2, 2, 2\)", via_velocity=torch.zeros(2, 2, 2), via_velocity_cov=torch.zeros(2, 2, 2, 2)
    ),
]
_SPACES = [
    *each(TaskSpace, "axes", ("yaw", None, 3), "axes are .*; expected one or more distinct names", origin=_ORIGIN),
    bad(TaskSpace, r"axes are \('x', 'roll'\)", ("x", "roll"), _ORIGIN),
    bad(TaskSpace, r"axes are \('x', 'x'\)", ("x", "x"), _ORIGIN),
    bad(TaskSpace, r"origin is \(0.4, 0.0, 0.1\); expected seven finite numbers", ("x",), (0.4, 0.0, 0.1)),
    bad(TaskSpace, "origin is None; expected seven", ("x",), None),
    bad(TaskSpace, r"origin is \(nan, .*; expected seven", ("x",), (math.nan, *_ORIGIN[1:])),
    bad(TaskSpace, r"origin has the quaternion \(0.0, 0.0, 0.0, 0.0\) of norm 0; expected a unit", ("x",), [0.0] * 7),
    bad(TaskSpace, r"origin .* norm 2; expected a unit quaternion", ("x",), (0.4, 0.0, 0.1, 0.0, 2.0, 0.0, 0.0)),
    bad(_SPACE.pose, r"task-space position has shape \(5, 3\); expected \(\*batch, 2\)", torch.zeros(5, 3)),
    bad(_SPACE.twist, r"task-space velocity has shape \(5, 3\)", torch.zeros(5, 3)),
    bad(_SPACE.difference, r"other has shape \(5, 1\)", torch.zeros(5, 2), torch.zeros(5, 1)),
    bad(_SPACE.project, r"pose has shape \(5, 6\); expected \(\*batch, 7\)", torch.zeros(5, 6)),
]
_KINEMATICS = [
    bad(Kinematics, "arm is 'panda', of type str; expected Arm", "panda", 0.1),
    *each(
        Kinematics, "tool_length", (-0.1, math.nan, 160.0, "long", None),
        "{name} is {value}; expected a finite number from 0 to 2 m", PANDA,
    ),
    bad(Kinematics, "dtype is torch.int64; expected torch.float32 or torch.float64", PANDA, 0.1, torch.int64),
    bad(Kinematics, "dtype is float32; expected", PANDA, 0.1, "float32"),
    bad(_ARM, r"joint_position has shape \(2, 6\); expected \(\*batch, 7\)", torch.zeros(2, 6)),
    bad(_ARM.jacobian, r"joint_position is \[0\], of type list", [0]),
    bad(_ARM.inverse, r"pose has shape \(1, 6\)", torch.zeros(1, 6), torch.zeros(1, 7)),
    bad(_ARM.inverse, r"guess has shape \(1, 6\)", torch.zeros(1, 7), torch.zeros(1, 6)),
    bad(_ARM.inverse, "pose holds 7 NaN", torch.full((1, 7), math.nan), torch.zeros(1, 7)),
    bad(_ARM.inverse, "no joint position found for 1 of the poses", torch.tensor([[9.0, 0, 0, 0, 1, 0, 0]]),
        torch.tensor([PANDA.home])),
    bad(_ARM.inverse, "iterations is 0; expected a whole number", torch.zeros(1, 7), torch.zeros(1, 7), iterations=0),
    bad(_ARM.inverse, "damping is nan; expected", torch.zeros(1, 7), torch.zeros(1, 7), damping=math.nan),
]  # fmt: skip
_GAINS = [
    bad(CartesianImpedanceController, "stiffness is 0.0; expected", 0.0),
    bad(CartesianImpedanceController, "stiffness is nan; expected positive finite numbers", math.nan),
    bad(CartesianImpedanceController, "stiffness.*(3 numbers|1, 2, 3).*expected.*(1 or 6|six)", (1.0, 2.0, 3.0)),
    bad(CartesianImpedanceController, "stiffness is 'soft'; expected", "soft"),
    bad(CartesianImpedanceController, "stiffness is None; expected", None),
    bad(CartesianImpedanceController, r"stiffness.*expected", [[1.0, 2.0], [3.0, 4.0, 5.0]]),
    bad(CartesianImpedanceController, "damping_ratio is -1.0; expected", damping_ratio=-1.0),
    bad(CartesianImpedanceController, "damping is inf; expected", damping=math.inf),
    bad(CartesianImpedanceController, "inertia.*nan.*; expected", inertia=(math.nan,) * 6),
    bad(CartesianImpedanceController(), r"pose has shape \(2, 6\)", *[torch.zeros(2, 6)] * 2, torch.zeros(2, 7),
        torch.zeros(2, 6)),
    bad(CartesianImpedanceController(), r"stiffness has shape \(2, 3\)", torch.zeros(2, 7), torch.zeros(2, 6),
        torch.zeros(2, 7), torch.zeros(2, 6), torch.ones(2, 3), torch.ones(2, 6)),
]  # fmt: skip
_ACTOR = {"in_keys": ["pose"], "in_size": 7, "action_size": 3}
_NETWORKS = [
    *each(make_actor, "in_size", (0, -7, 2.5, "7", 10**12), _WHOLE, ["pose"], action_size=3),
    *each(make_actor, "action_size", (0, math.nan, 10**12), _WHOLE, ["pose"], in_size=7),
    *each(make_actor, "initial_scale", (0.0, -1.0, math.nan, "small"), _POSITIVE, **_ACTOR),
    bad(make_actor, "in_keys is 'pose'; expected a list", "pose", 7, 3),
    bad(make_actor, r"in_keys is \[\]; expected a list of one or more observations", [], 7, 3),
    bad(make_actor, r"mirror has the factors \[1, 1\] for 7 entries", mirror=Mirror([1, 1], [1, 1, 1]), **_ACTOR),
    bad(make_actor, r"mirror has the factors .*0.5", mirror=Mirror([1] * 7, [1, 1, 0.5]), **_ACTOR),
    bad(make_actor, "mirror has the factors .*nan", mirror=Mirror([1] * 7, [1, 1, math.nan]), **_ACTOR),
    *each(make_critic, "in_size", (0, 1.5, 10**12), _WHOLE, ["pose"]),
    bad(make_critic, "in_keys is None; expected a list", None, 7),
    bad(update_input_norm, r"the data lacks \['pose'\]; expected", make_critic(["pose"], 7), TensorDict({}, 2)),
    bad(
        update_input_norm, "module is a TensorDictModule without input statistics; expected one of make_actor",
        TensorDictModule(nn.Linear(1, 1), ["a"], ["b"]), TensorDict({}, 2),
    ),
]  # fmt: skip
_ROWS = [DHRow(0.0, 0.3, 0.0), DHRow(0.1, 0.0, 0.0)]
_ARMS = [
    *each(find_arm, "name", ("octopus", "", None, 7, []), "arm {value} is unknown; expected one of .*'panda'"),
    bad(Chain, "offsets is empty; expected one Offset for each joint", (), 0.1),
    bad(Chain, "offset of joint 1 is 'up'; expected an Offset", ("up",), 0.1),
    bad(Chain, r"offset of joint 1 is .*nan", (Offset((math.nan, 0.0, 0.0), 0.0),), 0.1),
    bad(Chain, "flange is nan; expected finite numbers", PANDA.chain.offsets, math.nan),
    bad(Chain, "tool_turn is 'left'; expected finite numbers", PANDA.chain.offsets, 0.1, "left"),
    bad(Chain.modified_dh, "rows is empty; expected one DHRow", (), flange=0.1),
    bad(Chain.modified_dh, r"row 1 is \(0, 0, 0\); expected a DHRow", [(0, 0, 0)], flange=0.1),
    bad(Chain.modified_dh, "row 2 is .*inf.*; expected finite", [_ROWS[0], DHRow(0.0, math.inf, 0.0)], flange=0.1),
    bad(Chain.standard_dh, "rows is empty", ()),
    bad(Chain.standard_dh, "the last row is .*a=0.1.*; expected a = 0 and alpha = 0", _ROWS),
    _joints("the tables of the joints have the lengths .*'armature': 2.*; expected one entry", armature=(0.1, 0.1)),
    _joints("armature is 0.1; expected a tuple", armature=0.1),
    _joints(r"armature is \(nan, .*; expected numbers of at least 0", armature=(math.nan,) * 7),
    _joints(r"torque_limits: \(0.0, .*; expected finite numbers above 0", torque_limits=(0.0,) * 7),
    _joints(r"velocity_limits: \('fast', ", velocity_limits=("fast",) * 7),
    _joints(r"position_limits of joint 1 are \(1.0, -1.0\)", position_limits=(Limits(1.0, -1.0),) * 7),
    _joints(r"position_limits of joint 1 are \(-inf, inf\)", position_limits=(Limits(-math.inf, math.inf),) * 7),
    _joints("position_limits of joint 1 are 2.9; expected low < high", position_limits=(2.9,) * 7),
    _arm("name is ''; expected a short text", name=""),
    _arm("chain is None; expected a Chain", chain=None),
    _arm("joints is 7; expected a Joints", joints=7),
    _arm("panda has a chain of 7 joints, but .*'home': 2.*; expected 7 of each", home=(0.0, 0.0)),
    _arm("home of joint 4 is 0.0 rad; expected -3.0718 to -0.0698 rad", home=(0.0,) * 7),
    _arm("home of joint 1 is nan rad", home=(math.nan, *PANDA.home[1:])),
    _arm(r"reach is \(0.7, 0.3\); expected 0 < low < high", reach=Limits(0.7, 0.3)),
    _arm(r"reach is \(0.3, inf\)", reach=Limits(0.3, math.inf)),
    _arm("reach is 0.5; expected", reach=0.5),
    _arm(r"apparent_inertia is \(1.0, 1.0\); expected six", apparent_inertia=(1.0, 1.0)),
    _arm("mass of the links: .*-1.0", links=(PANDA.links[0]._replace(mass=-1.0), *PANDA.links[1:])),
    _arm(
        "link 1 is .*nan.*; expected finite numbers for its com",
        links=(PANDA.links[0]._replace(com=(math.nan, 0, 0)), *PANDA.links[1:]),
    ),
    _arm(r"shells belong to the links \[9\]; expected 0", shells=(PANDA.shells[0]._replace(link=9),)),
    _arm("the shape of a shell is 'ball'; expected one of", shells=(PANDA.shells[0]._replace(shape="ball"),)),
    _arm("radius of the shells: .*-0.1", shells=(PANDA.shells[0]._replace(radius=-0.1),)),
]

ENTRIES = [*_PRIMITIVE, *_MULTIPLIER, *_SPACES, *_KINEMATICS, *_GAINS, *_NETWORKS, *_ARMS]
