"""The Franka Emika Panda."""

from __future__ import annotations

import math

from ppt_rl.arms.arm import Arm, Inertial, Joints, Limits, Shell
from ppt_rl.arms.chain import Chain, DHRow

__all__ = ["PANDA"]

_HALF_PI = math.pi / 2
_WHITE = (0.95, 0.95, 0.94, 1.0)
_DARK = (0.13, 0.14, 0.16, 1.0)
_METAL = (0.62, 0.64, 0.67, 1.0)

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
#: White halves that meet at each joint, with a dark seam between them.
_SHELLS = (
    Shell(0, "cylinder", _WHITE, 0.088, (0.0, 0.0, 0.0), (0.0, 0.0, 0.032), edge=0.012),
    Shell(0, "tube", _WHITE, 0.048, (-0.085, 0.0, 0.048), (0.0, 0.0, 0.062)),
    Shell(0, "cylinder", _WHITE, 0.066, (0.0, 0.0, 0.015), (0.0, 0.0, 0.138), edge=0.012),
    Shell(1, "cylinder", _DARK, 0.0615, (0.0, 0.0, -0.200), (0.0, 0.0, -0.182), edge=0.003),
    Shell(1, "cylinder", _WHITE, 0.065, (0.0, 0.0, -0.188), (0.0, 0.0, -0.050), edge=0.012),
    Shell(1, "tube", _WHITE, 0.062, (0.0, 0.0, -0.110), (0.0, -0.040, 0.0), via=(0.0, 0.0, 0.010)),
    Shell(1, "cylinder", _WHITE, 0.064, (0.0, -0.090, 0.0), (0.0, -0.003, 0.0), edge=0.024),
    Shell(2, "cylinder", _DARK, 0.0600, (0.0, 0.0, -0.030), (0.0, 0.0, 0.030), edge=0.003),
    Shell(2, "cylinder", _WHITE, 0.064, (0.0, 0.0, 0.003), (0.0, 0.0, 0.090), edge=0.024),
    Shell(2, "tube", _WHITE, 0.062, (0.0, -0.120, 0.0), (0.0, 0.0, 0.040), via=(0.0, -0.010, 0.0)),
    Shell(2, "cylinder", _WHITE, 0.063, (0.0, -0.060, 0.0), (0.0, -0.188, 0.0), edge=0.012),
    Shell(3, "cylinder", _DARK, 0.0575, (0.0, 0.0, -0.134), (0.0, 0.0, -0.116), edge=0.003),
    Shell(3, "cylinder", _WHITE, 0.061, (0.0, 0.0, -0.122), (0.0, 0.0, -0.040), edge=0.012),
    Shell(3, "tube", _WHITE, 0.058, (0.0, 0.0, -0.080), (0.0825, 0.030, 0.0), via=(0.0, 0.0, 0.020), end_radius=0.050),
    Shell(3, "cylinder", _WHITE, 0.056, (0.0825, 0.003, 0.0), (0.0825, 0.078, 0.0), edge=0.022),
    Shell(4, "cylinder", _DARK, 0.0520, (0.0, 0.0, -0.030), (0.0, 0.0, 0.030), edge=0.003),
    Shell(4, "cylinder", _WHITE, 0.056, (0.0, 0.0, 0.003), (0.0, 0.0, 0.078), edge=0.022),
    Shell(
        4, "tube", _WHITE, 0.050, (0.0, 0.0, 0.030), (-0.0825, 0.080, 0.0), via=(-0.085, 0.0, 0.010), end_radius=0.056
    ),
    Shell(4, "cylinder", _WHITE, 0.059, (-0.0825, 0.065, 0.0), (-0.0825, 0.118, 0.0), edge=0.012),
    Shell(5, "cylinder", _DARK, 0.0545, (0.0, 0.0, -0.272), (0.0, 0.0, -0.258), edge=0.003),
    Shell(5, "cylinder", _WHITE, 0.058, (0.0, 0.0, -0.264), (0.0, 0.0, -0.180), edge=0.012),
    Shell(
        5, "tube", _WHITE, 0.056, (0.0, 0.0, -0.205), (0.0, 0.058, -0.010), via=(0.0, 0.058, -0.130), end_radius=0.043
    ),
    Shell(5, "cylinder", _WHITE, 0.050, (0.0, 0.094, 0.0), (0.0, 0.014, 0.0), edge=0.018),
    Shell(6, "cylinder", _DARK, 0.0460, (0.0, 0.0, -0.024), (0.0, 0.0, -0.004), edge=0.003),
    Shell(6, "cylinder", _WHITE, 0.050, (0.0, 0.0, -0.010), (0.0, 0.0, 0.056), edge=0.018),
    Shell(6, "tube", _WHITE, 0.046, (0.0, 0.0, 0.020), (0.088, 0.0, 0.0), via=(0.050, 0.0, 0.020)),
    Shell(6, "cylinder", _WHITE, 0.050, (0.088, -0.046, 0.0), (0.088, 0.046, 0.0), edge=0.014),
    Shell(7, "cylinder", _DARK, 0.0465, (0.0, 0.0, 0.040), (0.0, 0.0, 0.056), edge=0.003),
    Shell(7, "cylinder", _WHITE, 0.050, (0.0, 0.0, 0.051), (0.0, 0.0, 0.088), edge=0.012),
    Shell(7, "cylinder", _WHITE, 0.019, (0.044, 0.0, 0.056), (0.044, 0.0, 0.088), edge=0.006),
    Shell(7, "cylinder", _METAL, 0.0315, (0.0, 0.0, 0.080), (0.0, 0.0, 0.107), edge=0.002),
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
