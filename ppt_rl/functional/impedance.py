"""Cartesian impedance control: orientation error, wrench, joint torque, nullspace torque."""

from __future__ import annotations

import torch
from torch import Tensor

from ppt_rl.functional.checks import is_readable, require_last_dim
from ppt_rl.functional.constants import constant
from ppt_rl.functional.shape_checks import require_same_batch, require_trailing

__all__ = [
    "braking_part",
    "cartesian_impedance",
    "critical_damping",
    "joint_torque",
    "nullspace_torque",
    "orientation_error",
    "power",
]


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

    Raises:
        ValueError: if a shape does not fit.

    Source:
        Paper, section "Cartesian Impedance Control", with its sign and its frame corrected (docs/method.md).
    """
    require_last_dim("quat", quat, 4)
    require_last_dim("reference_quat", reference_quat, 4)
    require_same_batch(quat=quat, reference_quat=reference_quat)
    w, v = quat.split_with_sizes((1, 3), -1)
    wd, vd = reference_quat.split_with_sizes((1, 3), -1)
    error_w = (quat * reference_quat).sum(-1, keepdim=True)
    error_v = wd * v - w * vd - torch.linalg.cross(v, vd.expand_as(v))
    return constant(-2.0, error_w) * error_w * error_v


def critical_damping(stiffness: Tensor, damping_ratio: Tensor, inertia: Tensor) -> Tensor:
    r"""Damping of each axis that gives a damping ratio: ``d = 2 zeta sqrt(k m)``.

    Args:
        stiffness: ``(*B, 6)`` [N/m, N m/rad].
        damping_ratio: ``(*B, 6)`` zeta [-].
        inertia: ``(*B, 6)`` apparent inertia [kg, kg m^2].

    Returns:
        ``(*B, 6)`` damping [N s/m, N m s/rad].

    Raises:
        ValueError: if a shape does not fit.
    """
    for name, value in (("stiffness", stiffness), ("damping_ratio", damping_ratio), ("inertia", inertia)):
        require_last_dim(name, value, 6)
    require_same_batch(stiffness=stiffness, damping_ratio=damping_ratio, inertia=inertia)
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

    Raises:
        ValueError: if a shape does not fit.

    Source:
        Paper, eq. (5), with :func:`orientation_error` instead of the error printed there.
    """
    for name, value, size in (
        ("pose", pose, 7), ("twist", twist, 6), ("reference_pose", reference_pose, 7),
        ("reference_twist", reference_twist, 6), ("stiffness", stiffness, 6), ("damping", damping, 6),
    ):  # fmt: skip
        require_last_dim(name, value, size)
    require_same_batch(
        pose=pose, twist=twist, reference_pose=reference_pose, reference_twist=reference_twist, stiffness=stiffness,
        damping=damping,
    )  # fmt: skip
    position, quat = pose.split_with_sizes((3, 4), -1)
    reference_position, reference_quat = reference_pose.split_with_sizes((3, 4), -1)
    error = torch.cat([reference_position - position, orientation_error(quat, reference_quat)], -1)  # [m, -]
    return stiffness * error + damping * (reference_twist - twist)


def braking_part(twist: Tensor, reference_twist: Tensor, damping: Tensor) -> Tensor:
    r"""The part of the damper's wrench that brakes, axis by axis; what is left of it pulls along or does nothing.

    .. math:: d_i = \min\big(\max(D_i\,(\nu_{d,i} - \nu_i),\ \min(0, -D_i \nu_i)),\ \max(0, -D_i \nu_i)\big)

    Behind a reference at rest it is the whole ``-D twist``. Behind one that moves, ``-D twist`` mostly cancels against
    ``D twist_d``: only the part by which the end effector is faster than its reference brakes.

    Args:
        twist: ``(*B, 6)`` end-effector twist [m/s, rad/s].
        reference_twist: ``(*B, 6)`` desired twist [m/s, rad/s].
        damping: ``(*B, 6)`` diagonal of D [N s/m, N m s/rad].

    Returns:
        ``(*B, 6)`` wrench with ``d_i twist_i <= 0`` on every axis [N, N m].

    Raises:
        ValueError: if a shape does not fit.
    """
    for name, value in (("twist", twist), ("reference_twist", reference_twist), ("damping", damping)):
        require_last_dim(name, value, 6)
    require_same_batch(twist=twist, reference_twist=reference_twist, damping=damping)
    whole = -damping * twist
    damper = damping * (reference_twist - twist)
    return torch.minimum(torch.maximum(damper, whole.clamp_max(0.0)), whole.clamp_min(0.0))


def joint_torque(jacobian: Tensor, wrench: Tensor) -> Tensor:
    """Joint torque that makes the end effector apply ``wrench``: ``J^T wrench``.

    Args:
        jacobian: ``(*B, 6, N)`` geometric Jacobian, world axes.
        wrench: ``(*B, 6)`` [N, N m].

    Returns:
        ``(*B, N)`` torque [N m].

    Raises:
        ValueError: if a shape does not fit.
    """
    require_trailing("jacobian", jacobian, 6, "N")
    require_last_dim("wrench", wrench, 6)
    if jacobian.shape[:-2] != wrench.shape[:-1]:
        require_same_batch(**{"jacobian[..., 0]": jacobian[..., 0], "wrench": wrench})
    return _product(wrench.unsqueeze(-2), jacobian).squeeze(-2)


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

    Raises:
        ValueError: if a shape does not fit.

    Source:
        Khatib 1987, "A unified approach for motion and force control of robot manipulators", eq. (47).
    """
    require_trailing("jacobian", jacobian, 6, "N")
    require_last_dim("torque", torque, jacobian.shape[-1])
    require_last_dim("inertia", inertia, jacobian.shape[-1])
    weighted = jacobian / inertia  # J M^-1
    gram = _product(weighted, jacobian.mT)
    gram.diagonal(dim1=-2, dim2=-1).add_(constant(damping**2, gram))
    factor, _ = torch.linalg.cholesky_ex(gram)  # positive definite by construction, so no check that synchronises
    solved = _solve(factor, _product(weighted, torque.unsqueeze(-1)))
    return torque - _product(jacobian.mT, solved).squeeze(-1)


def _solve(factor: Tensor, right: Tensor) -> Tensor:
    """Solve ``L L^T x = right``; on a GPU in two steps, since the solution in one seems to make the host wait there."""
    if is_readable(factor):
        return torch.cholesky_solve(right, factor)
    lower = torch.linalg.solve_triangular(factor, right, upper=False)
    return torch.linalg.solve_triangular(factor.mT, lower, upper=True)


def power(effort: Tensor, flow: Tensor) -> Tensor:
    """Power ``effort . flow``, positive where the robot does work on the world.

    Args:
        effort: ``(*B, N)`` wrench [N, N m] or joint torque [N m].
        flow: ``(*B, N)`` twist [m/s, rad/s] or joint velocity [rad/s].

    Returns:
        ``(*B, 1)`` power [W].

    Raises:
        ValueError: if a shape does not fit.
    """
    require_trailing("effort", effort, "N")
    require_last_dim("flow", flow, effort.shape[-1])
    require_same_batch(effort=effort, flow=flow)
    return (effort * flow).sum(-1, keepdim=True)


def _product(one: Tensor, other: Tensor) -> Tensor:
    """``one @ other``; for one and the same batch without the views that ``@`` makes, which cost more than it does."""
    return torch.bmm(one, other) if one.ndim == other.ndim == 3 and len(one) == len(other) else one @ other
