"""The Franka Research 3: the Panda's kinematics with other limits and other inertia."""

from __future__ import annotations

from dataclasses import replace

from ppt_rl.arms.arm import Inertial, Joints, Limits
from ppt_rl.arms.panda import PANDA

__all__ = ["FR3"]

#: Limits and inertial parameters: Franka Robotics, ``franka_description``, ``robots/fr3``. Armature: that of MuJoCo
#: Menagerie's ``franka_fr3``, where it was identified in torque control.
_JOINTS = Joints(
    position_limits=(
        Limits(-2.7437, 2.7437),
        Limits(-1.7837, 1.7837),
        Limits(-2.9007, 2.9007),
        Limits(-3.0421, -0.1518),
        Limits(-2.8065, 2.8065),
        Limits(0.5445, 4.5169),
        Limits(-3.0159, 3.0159),
    ),
    velocity_limits=(2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26),
    torque_limits=(87.0,) * 4 + (12.0,) * 3,
    armature=(0.195,) * 4 + (0.074,) * 3,
    inertia=(1.724, 2.038, 1.354, 1.051, 0.106, 0.107, 0.074),
)
_LINKS = (
    Inertial(
        2.9274653454, (4.128e-7, -1.81251324e-2, -3.86035970e-2),
        (2.3927316e-2, 2.2482161e-2, 6.350098e-3, 1.3318e-5, -1.14048e-4, -1.995032e-3),
    ),
    Inertial(
        2.9355370338, (3.1828864e-3, -7.43221644e-2, 8.8146084e-3),
        (4.1938946e-2, 2.5145149e-2, 6.1702145e-2, 2.02573e-4, 4.077784e-3, -4.225216e-3),
    ),
    Inertial(
        2.2449013699, (4.07015686e-2, -4.8200565e-3, -2.89730823e-2),
        (2.4101425e-2, 1.9740533e-2, 1.9044494e-2, 2.404695e-3, -2.856269e-3, -2.104213e-3),
    ),
    Inertial(
        2.6155955791, (-4.59100965e-2, 6.30492960e-2, -8.5187868e-3),
        (3.4529983e-2, 2.8881622e-2, 4.1254712e-2, 1.3225523e-2, 1.0151430e-2, -9.76283e-4),
    ),
    Inertial(
        2.3271207594, (-1.6039605e-3, 2.92536262e-2, -9.72965990e-2),
        (5.1610278e-2, 4.7877297e-2, 1.6423626e-2, -5.715173e-3, -3.567317e-3, 1.0673985e-2),
    ),
    Inertial(
        1.8170376524, (5.97131221e-2, -4.10294666e-2, -1.01692726e-2),
        (5.412334e-3, 1.4058330e-2, 1.6080818e-2, 6.193456e-3, 1.421929e-3, -1.314075e-3),
    ),
    Inertial(
        0.6271432862, (4.5225817e-3, 8.6261921e-3, -1.61633251e-2),
        (2.10924e-4, 1.77186e-4, 5.9932e-5, -2.4333e-5, 4.5645e-5, 8.7441e-5),
    ),
)  # fmt: skip

FR3 = replace(PANDA, name="fr3", joints=_JOINTS, links=_LINKS, apparent_inertia=(10.25, 5.18, 9.61, 0.84, 0.79, 0.07))
