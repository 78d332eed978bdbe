"""The Universal Robots UR5e."""

from __future__ import annotations

import math

from ppt_rl.arms.arm import Arm, Inertial, Joints, Limits, Shell
from ppt_rl.arms.chain import Chain, DHRow

__all__ = ["UR5E"]

_HALF_PI = math.pi / 2
_TURN = 2 * math.pi
_BLUE = (0.47, 0.64, 0.76, 1.0)
_LIGHT = (0.80, 0.81, 0.82, 1.0)
_DARK = (0.24, 0.25, 0.27, 1.0)

#: Standard Denavit-Hartenberg table (Universal Robots, "DH parameters for calculations of kinematics and dynamics").
_ROWS = (
    DHRow(0.0, 0.1625, _HALF_PI),
    DHRow(-0.425, 0.0, 0.0),
    DHRow(-0.3922, 0.0, 0.0),
    DHRow(0.0, 0.1333, _HALF_PI),
    DHRow(0.0, 0.0997, -_HALF_PI),
    DHRow(0.0, 0.0996, 0.0),
)
#: Masses and centres of mass: the same article; tensors: Universal Robots, ``Universal_Robots_ROS2_Description``,
#: ``config/ur5e``; all in the frames of the table.
_LINKS = (
    Inertial(
        3.761, (0.0, -0.02561, 0.00193),
        (7.00210e-3, 6.48091e-3, 6.57286e-3, 7.3e-7, -1.053e-5, 4.9994e-4),
    ),
    Inertial(
        8.058, (0.2125, 0.0, 0.11336),
        (1.505885e-2, 3.3388086e-1, 3.3247207e-1, -5.4e-5, 5.63e-6, -1.81e-6),
    ),
    Inertial(
        2.846, (0.15, 0.0, 0.0265),
        (3.99632e-3, 7.879254e-2, 7.848510e-2, -1.365e-5, 1.37272e-3, -6.6e-6),
    ),
    Inertial(
        1.37, (0.0, -0.0018, 0.01634),
        (1.65491e-3, 1.35962e-3, 1.26279e-3, -2.82e-6, -4.38e-6, 1.0157e-4),
    ),
    Inertial(
        1.3, (0.0, 0.0018, 0.01634),
        (1.35617e-3, 1.27827e-3, 9.6614e-4, -2.74e-6, 4.44e-6, -5.048e-5),
    ),
    Inertial(
        0.365, (0.0, 0.0, -0.001159),
        (1.8694e-4, 1.8908e-4, 2.5756e-4, 6e-8, -1.7e-7, -9.2e-7),
    ),
)  # fmt: skip
#: Limits: Universal Robots, ``Universal_Robots_ROS2_Description`` (which cites the manual); the torque limits agree
#: with MuJoCo Menagerie's. The elbow's range is narrower, since the forearm meets the upper arm. Armature: the maker
#: publishes none, so it is that of MuJoCo Menagerie's model.
_JOINTS = Joints(
    position_limits=(
        Limits(-_TURN, _TURN),
        Limits(-_TURN, _TURN),
        Limits(-math.pi, math.pi),
        Limits(-_TURN, _TURN),
        Limits(-_TURN, _TURN),
        Limits(-_TURN, _TURN),
    ),
    velocity_limits=(math.pi,) * 6,
    torque_limits=(150.0,) * 3 + (28.0,) * 3,
    armature=(0.1,) * 6,
    inertia=(1.517, 2.145, 0.985, 0.125, 0.107, 0.100),
)
_SHELLS = (
    Shell(0, "cylinder", _DARK, 0.075, (0.0, 0.0, 0.0), (0.0, 0.0, 0.03), edge=0.002),
    Shell(0, "cylinder", _LIGHT, 0.064, (0.0, 0.0, 0.03), (0.0, 0.0, 0.095), edge=0.008),
    Shell(1, "cylinder", _DARK, 0.061, (0.0, 0.0, 0.095), (0.0, 0.0, 0.101), edge=0.002),
    Shell(1, "cylinder", _LIGHT, 0.060, (0.0, 0.0, 0.101), (0.0, 0.0, 0.2), edge=0.008),
    Shell(1, "cylinder", _BLUE, 0.060, (0.0, 0.0, 0.2), (0.0, 0.0, 0.221), edge=0.010),
    Shell(1, "cylinder", _LIGHT, 0.058, (0.0, 0.0, 0.1625), (0.0, -0.072, 0.1625), edge=0.008),
    Shell(2, "cylinder", _DARK, 0.059, (0.0, 0.0, 0.072), (0.0, 0.0, 0.078), edge=0.002),
    Shell(2, "cylinder", _LIGHT, 0.059, (0.0, 0.0, 0.078), (0.0, 0.0, 0.18), edge=0.008),
    Shell(2, "cylinder", _BLUE, 0.059, (0.0, 0.0, 0.18), (0.0, 0.0, 0.2), edge=0.010),
    Shell(2, "cylinder", _LIGHT, 0.047, (0.0, 0.0, 0.138), (-0.425, 0.0, 0.138), edge=0.008),
    Shell(2, "cylinder", _BLUE, 0.054, (-0.425, 0.0, 0.178), (-0.425, 0.0, 0.196), edge=0.010),
    Shell(2, "cylinder", _LIGHT, 0.054, (-0.425, 0.0, 0.073), (-0.425, 0.0, 0.178), edge=0.008),
    Shell(3, "cylinder", _DARK, 0.054, (0.0, 0.0, 0.067), (0.0, 0.0, 0.073), edge=0.002),
    Shell(3, "cylinder", _LIGHT, 0.053, (0.0, 0.0, -0.033), (0.0, 0.0, 0.067), edge=0.008),
    Shell(3, "cylinder", _BLUE, 0.053, (0.0, 0.0, -0.052), (0.0, 0.0, -0.033), edge=0.010),
    Shell(3, "cylinder", _LIGHT, 0.038, (0.0, 0.0, 0.007), (-0.3922, 0.0, 0.007), edge=0.008),
    Shell(3, "cylinder", _BLUE, 0.041, (-0.3922, 0.0, -0.048), (-0.3922, 0.0, -0.034), edge=0.010),
    Shell(3, "cylinder", _LIGHT, 0.041, (-0.3922, 0.0, -0.034), (-0.3922, 0.0, 0.067), edge=0.008),
    Shell(4, "cylinder", _DARK, 0.041, (0.0, 0.0, 0.067), (0.0, 0.0, 0.072), edge=0.002),
    Shell(4, "cylinder", _LIGHT, 0.040, (0.0, 0.0, 0.072), (0.0, 0.0, 0.166), edge=0.008),
    Shell(4, "cylinder", _BLUE, 0.040, (0.0, 0.0, 0.166), (0.0, 0.0, 0.18), edge=0.010),
    Shell(4, "cylinder", _LIGHT, 0.040, (0.0, 0.02, 0.1333), (0.0, -0.046, 0.1333), edge=0.008),
    Shell(5, "cylinder", _DARK, 0.040, (0.0, 0.0, 0.046), (0.0, 0.0, 0.051), edge=0.002),
    Shell(5, "cylinder", _LIGHT, 0.040, (0.0, 0.0, 0.051), (0.0, 0.0, 0.132), edge=0.008),
    Shell(5, "cylinder", _BLUE, 0.040, (0.0, 0.0, 0.132), (0.0, 0.0, 0.146), edge=0.010),
    Shell(5, "cylinder", _LIGHT, 0.039, (0.0, 0.0, 0.0997), (0.0, 0.056, 0.0997), edge=0.008),
    Shell(6, "cylinder", _DARK, 0.038, (0.0, 0.0, 0.056), (0.0, 0.0, 0.061), edge=0.002),
    Shell(6, "cylinder", _LIGHT, 0.0375, (0.0, 0.0, 0.061), (0.0, 0.0, 0.0996), edge=0.008),
)

#: The tool lies beside the plane of the two long links. The arm turns by this much to have it straight ahead [rad].
_ASIDE = math.atan(0.1333 / (0.3922 + 0.0997))

UR5E = Arm(
    name="ur5e",
    chain=Chain.standard_dh(_ROWS, tool_turn=-_HALF_PI),
    joints=_JOINTS,
    links=tuple(link.in_joint_frame(row) for link, row in zip(_LINKS, _ROWS, strict=True)),
    home=(-math.pi - _ASIDE, -_HALF_PI, _HALF_PI, -_HALF_PI, -_HALF_PI, -_ASIDE),
    reach=Limits(0.30, 0.70),  # It could be wider; the Panda's lets a seed draw the same mazes.
    apparent_inertia=(9.28, 5.36, 8.57, 0.43, 0.71, 0.10),
    shells=_SHELLS,
)
