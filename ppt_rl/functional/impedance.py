"""Cartesian impedance control: orientation error, wrench, joint torque, nullspace torque."""

from __future__ import annotations

import torch
from torch import Tensor

__all__ = ["cartesian_impedance", "critical_damping", "joint_torque", "nullspace_torque", "orientation_error", "power"]


def orientation_error(quat: Tensor, reference_quat: Tensor) -> Tensor:
    r"""Orientation error in world axes, pointing from the current to the desired orientation.

    .. math:: e_R = -\tfrac12 R_d\,(R_d^\top R - R^\top R_d)^\vee = -\sin(\theta)\, n

    where ``R R_d^T`` is a rotation by ``theta`` about the world axis ``n``. A torque along ``e_R`` turns ``R`` towards
    ``R_d``. The function computes the equivalent quaternion form ``-2 w v`` with ``q q_d^* = (w, v)``.

    Args:
        quat: ``(*B, 4)`` current orientation, w first.
        reference_quat: ``(*B, 4)`` desired orientation, w first.

    Returns:
        ``(*B, 3)`` error [-], world axes.

    Source:
        Paper, section "Cartesian Impedance Control", with its sign and its frame corrected (docs/method.md).
    """
    w, v = quat[..., :1], quat[..., 1:]
    wd, vd = reference_quat[..., :1], reference_quat[..., 1:]
    error_w = (quat * reference_quat).sum(-1, keepdim=True)
    error_v = wd * v - w * vd - torch.linalg.cross(v, vd.expand_as(v))
    return -2.0 * error_w * error_v


def critical_damping(stiffness: Tensor, damping_ratio: Tensor, inertia: Tensor) -> Tensor:
    r"""Damping of each axis that gives a damping ratio: ``d = 2 zeta sqrt(k m)``.

    Args:
        stiffness: ``(*B, 6)`` [N/m, N m/rad].
        damping_ratio: ``(*B, 6)`` zeta [-].
        inertia: ``(*B, 6)`` apparent inertia [kg, kg m^2].

    Returns:
        ``(*B, 6)`` damping [N s/m, N m s/rad].
    """
    return 2.0 * damping_ratio * (stiffness * inertia).sqrt()


def cartesian_impedance(
    pose: Tensor, twist: Tensor, reference_pose: Tensor, reference_twist: Tensor, stiffness: Tensor, damping: Tensor
) -> Tensor:
    r"""Wrench of a spring and a damper between the end effector and its reference.

    .. math:: \lambda = K\,[x_d - x;\ e_R] + D\,(\nu_d - \nu)

    Args:
        pose: ``(*B, 7)`` end-effector pose in world [m, -].
        twist: ``(*B, 6)`` end-effector twist, world axes [m/s, rad/s].
        reference_pose: ``(*B, 7)`` desired pose in world [m, -].
        reference_twist: ``(*B, 6)`` desired twist, world axes [m/s, rad/s].
        stiffness: ``(*B, 6)`` diagonal of K [N/m, N m/rad].
        damping: ``(*B, 6)`` diagonal of D [N s/m, N m s/rad].

    Returns:
        ``(*B, 6)`` wrench applied by the robot, world axes, at the end-effector point [N, N m].

    Source:
        Paper, eq. (5), with :func:`orientation_error` instead of the error printed there.
    """
    position_error = reference_pose[..., :3] - pose[..., :3]  # [m]
    rotation_error = orientation_error(pose[..., 3:], reference_pose[..., 3:])  # [-]
    error = torch.cat([position_error, rotation_error], -1)
    return stiffness * error + damping * (reference_twist - twist)


def joint_torque(jacobian: Tensor, wrench: Tensor) -> Tensor:
    """Joint torque that makes the end effector apply ``wrench``: ``J^T wrench``.

    Args:
        jacobian: ``(*B, 6, N)`` geometric Jacobian, world axes.
        wrench: ``(*B, 6)`` [N, N m].

    Returns:
        ``(*B, N)`` torque [N m].
    """
    return (wrench.unsqueeze(-2) @ jacobian).squeeze(-2)


def nullspace_torque(jacobian: Tensor, torque: Tensor, inertia: Tensor, damping: float = 0.02) -> Tensor:
    r"""The part of ``torque`` that moves the arm without accelerating the end effector.

    .. math:: \tau_n = \big(I - J^\top (J M^{-1} J^\top + \mu^2 I)^{-1} J M^{-1}\big)\, \tau

    This is the dynamically consistent projection for a diagonal inertia ``M``; with ``M = I`` it is the kinematic
    projection. The damping ``mu`` keeps it bounded near singularities.

    Args:
        jacobian: ``(*B, 6, N)`` geometric Jacobian.
        torque: ``(*B, N)`` posture torque before projection [N m].
        inertia: ``(N,)`` diagonal of M, approximate joint inertia [kg m^2].
        damping: regularisation ``mu`` [kg^-1/2].

    Returns:
        ``(*B, N)`` projected torque [N m].

    Source:
        Khatib 1987, "A unified approach for motion and force control of robot manipulators", eq. (47).
    """
    weighted = jacobian / inertia  # J M^-1
    gram = weighted @ jacobian.mT
    gram.diagonal(dim1=-2, dim2=-1).add_(damping**2)
    factor, _ = torch.linalg.cholesky_ex(gram)  # positive definite by construction, so no check that synchronises
    solved = torch.cholesky_solve(weighted @ torque.unsqueeze(-1), factor)
    return torque - (jacobian.mT @ solved).squeeze(-1)


def power(effort: Tensor, flow: Tensor) -> Tensor:
    """Power ``effort . flow``, positive where the robot does work on the world.

    Args:
        effort: ``(*B, N)`` wrench [N, N m] or joint torque [N m].
        flow: ``(*B, N)`` twist [m/s, rad/s] or joint velocity [rad/s].

    Returns:
        ``(*B, 1)`` power [W].
    """
    return (effort * flow).sum(-1, keepdim=True)
