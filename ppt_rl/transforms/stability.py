"""A warning where gains are too high for the rate at which a controller acts."""

from __future__ import annotations

import warnings
from functools import lru_cache

import torch
from torchrl.envs import EnvBase

from ppt_rl.arms import Arm
from ppt_rl.functional.impedance import nullspace_torque
from ppt_rl.functional.stability import spectral_radius
from ppt_rl.modules.impedance import CartesianImpedanceController
from ppt_rl.modules.kinematics import Kinematics
from ppt_rl.transforms.chain import transforms_of
from ppt_rl.transforms.joint_torque import JointTorqueTransform
from ppt_rl.transforms.timed import control_step

__all__ = ["warn_if_unstable"]


def warn_if_unstable(controller: CartesianImpedanceController, env: EnvBase) -> None:
    """Warn, once for each combination of arm, gains and rate, where the controller is unstable in discrete time.

    The arm is linearised at its home posture, with the inertia of its links, and the posture term of its
    :class:`JointTorqueTransform` is part of it. A chain without one, or an environment without a control step, is not
    judged.

    Args:
        controller: the controller.
        env: the environment that it acts on, with the transforms between them.
    """
    torque = next((t for t in transforms_of(env) if isinstance(t, JointTorqueTransform)), None)
    dt = control_step(env)
    if torque is None or dt is None:
        return
    kinematics = torque.kinematics
    gains = tuple(controller.stiffness.tolist()), tuple(controller.damping.tolist())
    posture = (torque.posture_stiffness, torque.posture_damping) if torque.has_nullspace else (0.0, 0.0)
    radius = _radius(kinematics.arm, kinematics.tool_length, *gains, *posture, dt)
    if radius > 1.0:
        _warn(
            f"the impedance is unstable at this rate: in each control step of {dt:g} s, small motions of "
            f"{kinematics.arm.name} at its home posture grow by a factor of {radius:.2f}; expected at most 1. The arm "
            f"will chatter. Lower the stiffness {_shown(gains[0])} or the damping {_shown(gains[1])}, above all the "
            "last three numbers of each, or the gains of the posture, or act more often."
        )


@lru_cache
def _radius(
    arm: Arm,
    tool_length: float,
    stiffness: tuple[float, ...],
    damping: tuple[float, ...],
    posture_stiffness: float,
    posture_damping: float,
    dt: float,
) -> float:
    f64 = torch.float64
    kinematics, home = Kinematics(arm, tool_length, dtype=f64), torch.tensor(arm.home, dtype=f64)
    jacobian, eye = kinematics.jacobian(home), torch.eye(arm.num_joints, dtype=f64)
    spring, damper = (jacobian.mT @ torch.tensor(gain, dtype=f64).diag() @ jacobian for gain in (stiffness, damping))
    if posture_stiffness or posture_damping:
        typical = torch.tensor(arm.joints.inertia, dtype=f64)
        projector = nullspace_torque(jacobian.expand(len(eye), -1, -1).clone(), eye, typical).mT
        spring, damper = spring + posture_stiffness * projector, damper + posture_damping * projector
    return float(spectral_radius(kinematics.inertia(home), spring, damper, dt))


@lru_cache
def _warn(message: str) -> None:
    """Warn once in a process."""
    warnings.warn(message, stacklevel=2)


def _shown(gains: tuple[float, ...]) -> str:
    return "(" + ", ".join(f"{gain:.3g}" for gain in gains) + ")"
