"""Bad arguments of the transforms and of the dataclasses of options that they take."""

from __future__ import annotations

import math

import torch

from ppt_rl.arms import PANDA
from ppt_rl.functional import MetricsConfig, PlaneBarrier, SpeedBarrier, ViaPointConfig, WallTouch
from ppt_rl.modules import CartesianImpedanceController, Kinematics, ProMP, TaskSpace
from ppt_rl.transforms import (
    ActionMapTransform,
    BarrierTransform,
    CartesianVelocityTransform,
    ContactViaPointTransform,
    EnergyAwareImpedanceTransform,
    EnergyBudgetTransform,
    EnergyPenaltyTransform,
    EnergyTankTransform,
    EpisodeMetricsTransform,
    HeadingFrameTransform,
    ImpedanceTransform,
    JointTorqueTransform,
    MacroStepTransform,
    MotionMemoryTransform,
    PowerLimitTransform,
    ProMPTransform,
    RecedingProMPTransform,
    ReferenceGovernorTransform,
    ViaPointTransform,
)
from tests.bad_inputs.entry import BadInput, bad, each

__all__ = ["ENTRIES"]

_POSITIVE, _WHOLE = "{name} is {value}; expected a finite number above 0", "{name} is {value}; expected a whole number"
_LEAST = "{name} is {value}; expected a finite number of at least 0"
_SHARE = "{name} is {value}; expected a number between 0 and 1, both excluded"
_ORIGIN = (0.4, 0.0, 0.1, 0.0, 1.0, 0.0, 0.0)
_PLANE, _SPACE = TaskSpace(("x", "y"), _ORIGIN), TaskSpace(("x", "y", "z"), _ORIGIN)
_PROMP, _PROMP3 = ProMP(4, 2, 1.0), ProMP(4, 3, 1.0)
_ARM = Kinematics(PANDA, 0.1)

_OPTIONS = [
    *each(WallTouch, "friction", (0.0, math.nan, math.inf, "rough", None), _POSITIVE),
    *each(WallTouch, "slow", (-0.1, math.inf), _POSITIVE),
    bad(WallTouch, "on and off are 0.4 and 0.5 N; expected on >= off > 0", on=0.4),
    bad(WallTouch, "on and off are inf and 0.5 N; expected .* finite", on=math.inf),
    bad(WallTouch, "on and off are 1.0 and None N; expected", off=None),
    *each(ViaPointConfig, "capacity", (0, 2.5, 10**9, "many"), _WHOLE),
    *each(ViaPointConfig, "lookahead", (0.0, math.nan, "far"), _POSITIVE),
    *each(ViaPointConfig, "spacing", (0.0, math.inf), _POSITIVE),
    *each(ViaPointConfig, "offset", (-0.1, math.nan, math.inf), _LEAST),
    *each(ViaPointConfig, "turn", (0.0, 3.2, math.nan, "left"), "turn is {value}|turn is left"),
    bad(ViaPointConfig, r"std is \(0.02, 0.02\); expected three finite numbers .m.", std=(0.02, 0.02)),
    bad(ViaPointConfig, "std is 0.02; expected three", std=0.02),
    bad(ViaPointConfig, "std is -0.01; expected a finite number above 0 m", std=(0.02, -0.01, 0.02)),
    *each(MetricsConfig, "p_max", (0.0, -2.0, math.nan, math.inf, "2", None), _POSITIVE),
    *each(MetricsConfig, "cutoff", (0.0, math.inf), _POSITIVE),
    *each(MetricsConfig, "contact_force", (-1.0, None), _POSITIVE),
]
_AT_CONTROL_RATE = [
    *each(EnergyTankTransform, "p_max", (0.0, -2.0, math.nan, math.inf, "2", None), _POSITIVE),
    *each(EnergyTankTransform, "e_max", (0.0, math.nan, True), _POSITIVE),
    *each(EnergyTankTransform, "dt", (0.0, -0.01, math.nan, "fast"), _POSITIVE),
    *each(EnergyTankTransform, "eps", (0.0, math.nan), _POSITIVE),
    *each(EnergyTankTransform, "mode", ("papre", "", None), "{name} is {value}; expected one of"),
    bad(EnergyTankTransform, r"out_keys are \('level',\); expected two", out_keys=("level",)),
    bad(EnergyTankTransform, "inertia is None; expected the inertia that the effort accelerates", mode="rate"),
    bad(EnergyTankTransform, "damping_key is None; expected the key under which an Imp", mode="parallel"),
    bad(EnergyTankTransform, "inertia is given, but mode='paper' reads no inertia.*Leave it out", inertia=(1.0,) * 7),
    bad(EnergyTankTransform, "damping_key is given, but mode='passive' reads no", mode="passive", damping_key="d"),
    *each(
        EnergyTankTransform,
        "inertia",
        ((0.0, 1.0), (1.0, math.nan), -1.0, "heavy", [[1.0, 2.0], [2.0, 1.0]], ()),
        "inertia is .*; expected positive numbers, one for each axis of the effort, or a positive definite matrix",
        mode="rate",
    ),
    bad(
        EnergyTankTransform,
        "p_max_key is 'x' and e_max_key 'x'; expected keys that differ",
        p_max_key="x",
        e_max_key="x",
    ),
    bad(EnergyTankTransform, "p_max_key is 'valve'.*expected keys that differ", p_max_key="valve"),
    bad(
        EnergyTankTransform,
        "out_keys.*tank_energy.*expected two",
        out_keys=("tank_energy", "tank_energy"),
    ),
    bad(JointTorqueTransform, "kinematics is .*expected (a )?Kinematics", PANDA),
    bad(JointTorqueTransform, "posture has 6 numbers; expected 7 joint positions", _ARM, posture=(0.0,) * 6),
    bad(JointTorqueTransform, "posture.*nan.*; expected", _ARM, posture=(math.nan,) * 7),
    bad(
        JointTorqueTransform,
        "posture_stiffness is -1.0; expected .* at least 0",
        _ARM,
        posture_stiffness=-1.0,
    ),
    bad(JointTorqueTransform, "posture_stiffness.*nan.*; expected", _ARM, posture_stiffness=math.nan),
    bad(JointTorqueTransform, "posture_damping.*inf.*; expected", _ARM, posture_damping=math.inf),
    *each(JointTorqueTransform, "max_torque_rate", (0.0, math.nan, "slow"), _POSITIVE, _ARM),
    bad(ImpedanceTransform, "controller is .*; expected (a )?CartesianImpedanceController", 400.0),
    bad(ImpedanceTransform, "controller is .*; expected", CartesianImpedanceController),
    bad(EpisodeMetricsTransform, "config is .*; expected (a )?MetricsConfig", 2.0),
    bad(EpisodeMetricsTransform, "cutoff is 10.0 Hz; expected a frequency below half the control rate", dt=0.05),
    *each(EnergyBudgetTransform, "e_max", (0.0, -1.0, math.nan, math.inf, "full", None), _POSITIVE),
    *each(EnergyBudgetTransform, "weight", (-1.0, math.nan, math.inf, "much", None), _LEAST, 1.0),
    *each(EnergyBudgetTransform, "least_share", (0.0, 1.0, math.nan, "none", None), _SHARE, 1.0),
    *each(EnergyBudgetTransform, "initial_share", (0.0, 1.0, -0.1, "all", None), _SHARE, 1.0),
    *each(EnergyPenaltyTransform, "weight", (-1.0, math.nan, math.inf, "much", None), _LEAST),
    *each(PowerLimitTransform, "p_max", (-1.0, math.nan, "two"), _LEAST),
    *each(PowerLimitTransform, "penalty", (-1.0, math.nan, math.inf, "much", None), _LEAST),
    bad(PowerLimitTransform, "terminate is 'no', of type str; expected bool", terminate="no"),
    *each(PowerLimitTransform, "dt", (0.0, [0.01]), _POSITIVE),
    *each(HeadingFrameTransform, "distance", (0.0, math.nan, "near"), _POSITIVE),
    *each(HeadingFrameTransform, "patience", (-1.0,), _POSITIVE),
    *each(HeadingFrameTransform, "smoothing", (0.0, math.inf), _POSITIVE),
    *each(MotionMemoryTransform, "slow", (0.0, math.nan), _POSITIVE),
    *each(MotionMemoryTransform, "memory", (-1.0, "long"), _POSITIVE),
    *each(MotionMemoryTransform, "distance", (0.0,), _POSITIVE),
    *each(MotionMemoryTransform, "reach", (math.inf,), _POSITIVE),
    bad(HeadingFrameTransform, "touch is 0.25, of type float; expected WallTouch", touch=0.25),
    *each(ContactViaPointTransform, "duration", (0.0, math.nan, "long"), _POSITIVE),
    bad(ContactViaPointTransform, "config is .*, of type WallTouch; expected ViaPointConfig", 1.0, WallTouch()),
    bad(ContactViaPointTransform, "touch is 'soft', of type str; expected WallTouch", 1.0, touch="soft"),
    bad(ContactViaPointTransform, "lookahead is 0.6 s; expected at most the primitive's duration, 0.5 s", 0.5),
]
_FORCE = [
    *each(ReferenceGovernorTransform, "f_max", (0.0, math.nan, "soft", None), _POSITIVE),
    *each(ReferenceGovernorTransform, "torque_max", (-1.0, math.inf), _POSITIVE),
    *each(ReferenceGovernorTransform, "catch_up_speed", (0.0, (0.1, 0.1, 0.1), "slow", math.nan), "{name} is .*; exp"),
    bad(ReferenceGovernorTransform, "with_motion is 1, of type int; expected bool", with_motion=1),
    bad(ReferenceGovernorTransform, "controller is 400.0, of type float; expected", controller=400.0),
    bad(ReferenceGovernorTransform, "reading_keys is 'pose'; expected two keys", reading_keys="pose"),
    *each(ReferenceGovernorTransform, "dt", (0.0, math.nan), _POSITIVE),
    bad(EnergyAwareImpedanceTransform, "controller is 400.0, of type float; expected", 400.0),
    *each(EnergyAwareImpedanceTransform, "e_max", (0.0, math.nan, "little"), _POSITIVE, CartesianImpedanceController()),
    *each(EnergyAwareImpedanceTransform, "p_max", (-2.0, math.inf), _POSITIVE, CartesianImpedanceController()),
    bad(BarrierTransform, "there are 0 barriers; expected 1 to 4", []),
    bad(BarrierTransform, "there are 5 barriers; expected 1 to 4", [SpeedBarrier(0.2)] * 5),
    bad(BarrierTransform, r"barriers is \[0.2\]; expected a list of them", [0.2]),
    bad(BarrierTransform, "barriers is 'slow'; expected a list of them", "slow"),
    *each(BarrierTransform, "force_rate", (0.0, math.nan, "slow"), _POSITIVE, [SpeedBarrier(0.2)]),
    *each(BarrierTransform, "inertia", (1.0, (1.0, 1.0, 0.0), None), "{name} is .*; expected", [SpeedBarrier(0.2)]),
    bad(BarrierTransform, "reading_keys is 'pose'; expected two keys", [SpeedBarrier(0.2)], reading_keys="pose"),
    *each(SpeedBarrier, "v_max", (0.0, -0.2, math.nan, "slow"), _POSITIVE),
    *each(SpeedBarrier, "rate", (0.0, math.inf), _POSITIVE, 0.2),
    bad(PlaneBarrier, r"normal is \(0.0, 0.0, 0.0\); expected three numbers that are not all zero", (0.0, 0.0, 0.0)),
    bad(PlaneBarrier, "normal is up; expected three|normal is 'up'; expected three", "up"),
    *each(PlaneBarrier, "offset", (math.nan, "high"), "{name} is {value}; expected"),
]
_VELOCITY = [
    *each(
        CartesianVelocityTransform, "max_velocity", (0.0, -0.4, math.nan, (0.1, 0.1, 0.1), math.inf),
        "{name}.*; expected", _PLANE,
    ),
    bad(CartesianVelocityTransform, "max_lead.*far.*; expected", _PLANE, max_lead="far"),
    bad(CartesianVelocityTransform, "max_lead is None; expected", _PLANE, max_lead=None),
    bad(CartesianVelocityTransform, r"task_space has the coordinates \('x', 'y'\)", _PLANE, heading_key="heading"),
    bad(CartesianVelocityTransform, "task_space is .*; expected (a )?TaskSpace", ("x", "y")),
]  # fmt: skip
_PER_POLICY_STEP = [
    bad(ActionMapTransform, "matrix is 0.1, of type float; expected Tensor", 0.1),
    bad(ActionMapTransform, r"matrix has shape \(3,\); expected finite numbers \(N, M\)", torch.ones(3)),
    bad(ActionMapTransform, r"matrix has shape \(0, 3\); expected finite", torch.ones(0, 3)),
    bad(ActionMapTransform, "expected finite numbers", torch.full((2, 2), math.nan)),
    *each(MacroStepTransform, "num_steps", (0, -1), "{name} is {value}; expected"),
    *each(MacroStepTransform, "num_steps", (2.5, "ten", math.nan, [4]), "{name}.*; expected"),
    *each(MacroStepTransform, "discount", (0.0, 1.01, math.nan), "{name} is {value}; expected"),
    *each(MacroStepTransform, "discount", ("high", None), "{name}.*; expected"),
    bad(MacroStepTransform, "trace_keys.*power.*; expected", 5, trace_keys="power"),
    bad(ProMPTransform, "the ProMP has 2 degrees of freedom .*; expected equal numbers", _PROMP, _SPACE),
    bad(ProMPTransform, "promp is .*; expected (a )?ProMP", None, _PLANE),
    bad(ProMPTransform, "task_space is .*; expected (a )?TaskSpace", _PROMP, "xy"),
    *each(
        ProMPTransform, "residual_scale", (0.0, -0.1, (0.1, 0.1, 0.1)), "{name} is {value}; expected", _PROMP, _PLANE
    ),
    *each(
        ProMPTransform, "residual_scale", ("small", None, math.inf), "{name}.*; expected", _PROMP, _PLANE
    ),
    bad(ProMPTransform, "duration is 1.0 s; expected a multiple of the control step, dt=0.03 s", _PROMP, _PLANE,
        dt=0.03),
    *each(ProMPTransform, "replan_steps", (0, 101), "{name} is {value}; expected .*1", _PROMP, _PLANE, dt=0.01),
    *each(
        ProMPTransform, "replan_steps", (2.5, "all"), "{name}.*{value}; expected", _PROMP, _PLANE, dt=0.01
    ),
    bad(RecedingProMPTransform, "promp is None, of type NoneType; expected ProMP", None, _SPACE),
    bad(RecedingProMPTransform, "task_space is .* of type tuple; expected TaskSpace", _PROMP3, ("x", "y", "z")),
    BadInput("a receding primitive without a height", lambda: RecedingProMPTransform(_PROMP, _PLANE),
             r"task_space has the coordinates \('x', 'y'\)"),
    bad(RecedingProMPTransform, "the ProMP has 2 degrees of freedom", _PROMP, _SPACE),
    *each(RecedingProMPTransform, "max_slip", (-0.1, math.nan, math.inf, "none"), _LEAST, _PROMP3, _SPACE),
    *each(
        RecedingProMPTransform, "max_lead", ((0.1, 0.1), 0.1, (0.1, -0.1, 0.0), (math.nan,) * 3, "far", None),
        "{name} is {value}; expected three numbers of at least 0 m", _PROMP3, _SPACE,
    ),
    bad(RecedingProMPTransform, "keys is 'action', of type str; expected RecedingKeys", _PROMP3, _SPACE, keys="action"),
    bad(ViaPointTransform, "promp is 4, of type int; expected ProMP", 4),
    bad(ViaPointTransform, "prefix is 'agent'; expected a tuple", _PROMP3, prefix="agent"),
    bad(ViaPointTransform, r"frame is \('pose',\); expected two keys", _PROMP3, frame=("pose",)),
    bad(ViaPointTransform, "frame is 'pose'; expected two keys", _PROMP3, frame="pose"),
    bad(ViaPointTransform, "the ProMP has 2 degrees of freedom; expected 3", _PROMP, frame=("pose", "heading")),
]  # fmt: skip

ENTRIES = [*_OPTIONS, *_AT_CONTROL_RATE, *_FORCE, *_VELOCITY, *_PER_POLICY_STEP]
