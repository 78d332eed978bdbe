"""Numbers of the Franka Emika Panda: geometry, limits and identified inertial parameters."""

from __future__ import annotations

import math
from typing import NamedTuple

__all__ = [
    "DH",
    "FLANGE",
    "HOME",
    "INERTIAL",
    "JOINT_INERTIA",
    "JOINT_LIMITS",
    "TORQUE_LIMITS",
    "VELOCITY_LIMITS",
    "Inertial",
    "Limits",
]


class Limits(NamedTuple):
    """Closed interval.

    Attributes:
        low: lower end.
        high: upper end.
    """

    low: float
    high: float


class Inertial(NamedTuple):
    """Inertial parameters of a link, in the frame of its joint.

    Attributes:
        mass: [kg].
        com: centre of mass [m].
        inertia: ixx, iyy, izz, ixy, ixz, iyz about the centre of mass [kg m^2].
    """

    mass: float
    com: tuple[float, float, float]
    inertia: tuple[float, float, float, float, float, float]


_HALF_PI = math.pi / 2
#: Modified (Craig) Denavit-Hartenberg rows ``(a [m], d [m], alpha [rad])`` of joints 1 to 7 (Franka Emika's own).
DH = (
    (0.0, 0.333, 0.0),
    (0.0, 0.0, -_HALF_PI),
    (0.0, 0.316, _HALF_PI),
    (0.0825, 0.0, _HALF_PI),
    (-0.0825, 0.384, -_HALF_PI),
    (0.0, 0.0, _HALF_PI),
    (0.088, 0.0, _HALF_PI),
)
#: Flange along the axis of joint 7 [m] and the turn of a tool frame about it [rad].
FLANGE = (0.107, -math.pi / 4)
#: Joint position limits [rad].
JOINT_LIMITS = (
    Limits(-2.8973, 2.8973),
    Limits(-1.7628, 1.7628),
    Limits(-2.8973, 2.8973),
    Limits(-3.0718, -0.0698),
    Limits(-2.8973, 2.8973),
    Limits(-0.0175, 3.7525),
    Limits(-2.8973, 2.8973),
)
#: Joint velocity limits [rad/s].
VELOCITY_LIMITS = (2.175,) * 4 + (2.61,) * 3
#: Joint torque limits [N m].
TORQUE_LIMITS = (87.0,) * 4 + (12.0,) * 3
#: Ready pose of the arm, tool pointing down [rad].
HOME = (0.0, -math.pi / 4, 0.0, -3 * math.pi / 4, 0.0, math.pi / 2, math.pi / 4)
#: Diagonal of the joint inertia matrix with rotors: medians over the push workspace
#: (``python benchmarks/apparent_inertia.py``) [kg m^2].
JOINT_INERTIA = (1.58, 1.87, 1.21, 0.91, 0.127, 0.135, 0.105)
#: Identified inertial parameters of links 1 to 7 (Gaz et al., RA-L 2019, "Dynamic identification of the Franka Emika
#: Panda robot with retrieval of feasible parameters using penalty-based optimization").
INERTIAL = (
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
