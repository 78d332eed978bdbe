"""The Franka Emika Panda."""

from __future__ import annotations

import math

from ppt_rl.arms.arm import Arm, Inertial, Joints, Limits, Shell
from ppt_rl.arms.chain import Chain, DHRow

__all__ = ["PANDA"]

_HALF_PI = math.pi / 2
_WHITE = (0.93, 0.93, 0.92, 1.0)
_GREY = (0.32, 0.34, 0.37, 1.0)

#: Modified Denavit-Hartenberg table (Franka Robotics, "Robot and interface specifications").
_CHAIN = Chain.modified_dh(
    (
        DHRow(0.0, 0.333, 0.0),
        DHRow(0.0, 0.0, -_HALF_PI),
        DHRow(0.0, 0.316, _HALF_PI),
        DHRow(0.0825, 0.0, _HALF_PI),
        DHRow(-0.0825, 0.384, -_HALF_PI),
        DHRow(0.0, 0.0, _HALF_PI),
        DHRow(0.088, 0.0, _HALF_PI),
    ),
    flange=0.107,
    tool_turn=-math.pi / 4,
)
#: Limits: the same specifications. Armature: an estimate of the right order, which keeps the wrist calm at 100 Hz.
_JOINTS = Joints(
    position_limits=(
        Limits(-2.8973, 2.8973),
        Limits(-1.7628, 1.7628),
        Limits(-2.8973, 2.8973),
        Limits(-3.0718, -0.0698),
        Limits(-2.8973, 2.8973),
        Limits(-0.0175, 3.7525),
        Limits(-2.8973, 2.8973),
    ),
    velocity_limits=(2.175,) * 4 + (2.61,) * 3,
    torque_limits=(87.0,) * 4 + (12.0,) * 3,
    armature=(0.1,) * 7,
    inertia=(1.58, 1.87, 1.21, 0.91, 0.127, 0.135, 0.105),
)
#: Gaz et al., "Dynamic identification of the Franka Emika Panda robot with retrieval of feasible parameters using
#: penalty-based optimization", IEEE Robotics and Automation Letters, 2019.
_LINKS = (
    Inertial(
        4.970684, (3.875e-3, 2.081e-3, -4.762e-2),
        (7.0337e-1, 7.0661e-1, 9.1170e-3, -1.3900e-4, 6.7720e-3, 1.9169e-2),
    ),
    Inertial(
        0.646926, (-3.141e-3, -2.872e-2, 3.495e-3),
        (7.9620e-3, 2.8110e-2, 2.5995e-2, -3.9250e-3, 1.0254e-2, 7.0400e-4),
    ),
    Inertial(
        3.228604, (2.7518e-2, 3.9252e-2, -6.6502e-2),
        (3.7242e-2, 3.6155e-2, 1.0830e-2, -4.7610e-3, -1.1396e-2, -1.2805e-2),
    ),
    Inertial(
        3.587895, (-5.317e-2, 1.04419e-1, 2.7454e-2),
        (2.5853e-2, 1.9552e-2, 2.8323e-2, 7.7960e-3, -1.3320e-3, 8.6410e-3),
    ),
    Inertial(
        1.225946, (-1.1953e-2, 4.1065e-2, -3.8437e-2),
        (3.5549e-2, 2.9474e-2, 8.6270e-3, -2.1170e-3, -4.0370e-3, 2.2900e-4),
    ),
    Inertial(
        1.666555, (6.0149e-2, -1.4117e-2, -1.0517e-2),
        (1.9640e-3, 4.3540e-3, 5.4330e-3, 1.0900e-4, -1.1580e-3, 3.4100e-4),
    ),
    Inertial(
        0.735522, (1.0517e-2, -4.252e-3, 6.1597e-2),
        (1.2516e-2, 1.0027e-2, 4.8150e-3, -4.2800e-4, -1.1960e-3, -7.4100e-4),
    ),
)  # fmt: skip
_SHELLS = (
    Shell(0, "cylinder", _WHITE, 0.078, (0.0, 0.0, 0.0), (0.0, 0.0, 0.05)),
    Shell(0, "capsule", _WHITE, 0.062, (-0.06, 0.0, 0.035), (0.0, 0.0, 0.05)),
    Shell(0, "cylinder", _WHITE, 0.060, (0.0, 0.0, 0.05), (0.0, 0.0, 0.14)),
    Shell(1, "cylinder", _GREY, 0.0585, (0.0, 0.0, -0.193), (0.0, 0.0, -0.185)),
    Shell(1, "cylinder", _WHITE, 0.060, (0.0, 0.0, -0.185), (0.0, 0.0, -0.06)),
    Shell(1, "capsule", _WHITE, 0.060, (0.0, 0.0, -0.07), (0.0, 0.0, -0.01)),
    Shell(1, "cylinder", _WHITE, 0.057, (0.0, -0.075, 0.0), (0.0, 0.02, 0.0)),
    Shell(2, "cylinder", _GREY, 0.054, (0.0, 0.0, 0.075), (0.0, 0.0, 0.083)),
    Shell(2, "cylinder", _WHITE, 0.057, (0.0, 0.0, -0.02), (0.0, 0.0, 0.075)),
    Shell(2, "capsule", _WHITE, 0.058, (0.0, -0.03, 0.0), (0.0, -0.14, 0.0)),
    Shell(2, "cylinder", _WHITE, 0.056, (0.0, -0.12, 0.0), (0.0, -0.19, 0.0)),
    Shell(3, "cylinder", _GREY, 0.0535, (0.0, 0.0, -0.126), (0.0, 0.0, -0.119)),
    Shell(3, "cylinder", _WHITE, 0.055, (0.0, 0.0, -0.119), (0.0, 0.0, -0.06)),
    Shell(3, "capsule", _WHITE, 0.055, (0.0, 0.0, -0.065), (0.0825, 0.0, 0.0)),
    Shell(3, "cylinder", _WHITE, 0.050, (0.0825, -0.065, 0.0), (0.0825, 0.02, 0.0)),
    Shell(4, "cylinder", _GREY, 0.047, (0.0, 0.0, 0.065), (0.0, 0.0, 0.073)),
    Shell(4, "cylinder", _WHITE, 0.050, (0.0, 0.0, -0.02), (0.0, 0.0, 0.065)),
    Shell(4, "capsule", _WHITE, 0.053, (0.0, 0.0, 0.0), (-0.0825, 0.075, 0.0)),
    Shell(4, "cylinder", _WHITE, 0.052, (-0.0825, 0.07, 0.0), (-0.0825, 0.115, 0.0)),
    Shell(5, "cylinder", _GREY, 0.0505, (0.0, 0.0, -0.269), (0.0, 0.0, -0.262)),
    Shell(5, "cylinder", _WHITE, 0.052, (0.0, 0.0, -0.262), (0.0, 0.0, -0.19)),
    Shell(5, "capsule", _WHITE, 0.046, (0.0, 0.02, -0.195), (0.0, 0.062, -0.09)),
    Shell(5, "capsule", _WHITE, 0.042, (0.0, 0.062, -0.09), (0.0, 0.062, -0.005)),
    Shell(5, "cylinder", _WHITE, 0.047, (0.0, 0.085, 0.0), (0.0, 0.015, 0.0)),
    Shell(6, "cylinder", _GREY, 0.045, (0.0, 0.0, -0.020), (0.0, 0.0, -0.013)),
    Shell(6, "cylinder", _WHITE, 0.048, (0.0, 0.0, -0.013), (0.0, 0.0, 0.050)),
    Shell(6, "capsule", _WHITE, 0.044, (0.0, 0.0, 0.015), (0.088, 0.0, 0.01)),
    Shell(6, "cylinder", _WHITE, 0.046, (0.088, -0.045, 0.0), (0.088, 0.04, 0.0)),
    Shell(7, "cylinder", _GREY, 0.043, (0.0, 0.0, 0.046), (0.0, 0.0, 0.052)),
    Shell(7, "cylinder", _WHITE, 0.044, (0.0, 0.0, 0.052), (0.0, 0.0, 0.085)),
    Shell(7, "cylinder", _GREY, 0.032, (0.0, 0.0, 0.085), (0.0, 0.0, 0.107)),
)

PANDA = Arm(
    name="panda",
    chain=_CHAIN,
    joints=_JOINTS,
    links=_LINKS,
    home=(0.0, -math.pi / 4, 0.0, -3 * math.pi / 4, 0.0, math.pi / 2, math.pi / 4),
    reach=Limits(0.30, 0.70),
    apparent_inertia=(8.35, 4.90, 8.75, 0.91, 0.75, 0.10),
    shells=_SHELLS,
)
