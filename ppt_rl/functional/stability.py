"""Whether a controller that acts at a fixed rate is stable."""

from __future__ import annotations

import torch
from torch import Tensor

__all__ = ["largest_damping_factor", "spectral_radius"]


def spectral_radius(inertia: Tensor, stiffness: Tensor, damping: Tensor, dt: float) -> Tensor:
    r"""Largest growth of a small motion in one control step, under a spring and a damper that act at a fixed rate.

    The torque ``-K x - D v`` is computed at the beginning of a control step and held until its end, so

    .. math::
        \begin{pmatrix} x' \\ v' \end{pmatrix} =
        \begin{pmatrix}
            I - \tfrac12 \Delta t^2 M^{-1} K & \Delta t\, I - \tfrac12 \Delta t^2 M^{-1} D \\
            -\Delta t\, M^{-1} K & I - \Delta t\, M^{-1} D
        \end{pmatrix}
        \begin{pmatrix} x \\ v \end{pmatrix}

    The result is the largest absolute eigenvalue of this matrix. Above 1 the motion grows until something stops it: the
    arm chatters. With ``dt`` going to zero, every positive damping is stable.

    Args:
        inertia: ``(*B, n, n)`` inertia matrix M [kg m^2].
        stiffness: ``(*B, n, n)`` stiffness matrix K [N m/rad].
        damping: ``(*B, n, n)`` damping matrix D [N m s/rad].
        dt: control step [s].

    Returns:
        ``(*B,)`` spectral radius [-].
    """
    spring, damper = torch.linalg.solve(inertia, stiffness), torch.linalg.solve(inertia, damping)
    eye = torch.eye(inertia.shape[-1], dtype=inertia.dtype, device=inertia.device).expand_as(inertia)
    position = torch.cat([eye - 0.5 * dt**2 * spring, dt * eye - 0.5 * dt**2 * damper], -1)
    velocity = torch.cat([-dt * spring, eye - dt * damper], -1)
    return torch.linalg.eigvals(torch.cat([position, velocity], -2)).abs().amax(-1)


def largest_damping_factor(damping: Tensor, inertia: Tensor, dt: float) -> Tensor:
    r"""How many times the damping may grow before a damper that acts at a fixed rate turns a velocity around.

    .. math:: \beta_{max} = \max\Big(1,\ \min_i \frac{m_i}{d_i\,\Delta t}\Big)

    A mass ``m`` whose damper ``d`` holds its force for a control step goes on with ``(1 - d dt / m) v``. Beside a
    spring ``k`` it is stable (:func:`spectral_radius` at most 1) exactly for ``k dt^2 / 2 <= d dt <= 2 m``. So a
    damping of up to ``beta_max`` times ``d`` keeps a stable axis stable, with a factor of two to spare for an inertia
    that is smaller than the one given.

    Args:
        damping: ``(*B, n)`` diagonal of D [N s/m, N m s/rad].
        inertia: ``(*B, n)`` diagonal of the apparent inertia M [kg, kg m^2].
        dt: control step [s].

    Returns:
        ``(*B, 1)`` factor, at least 1; 1 also where the damping itself is too large.
    """
    return (inertia / (damping * dt)).amin(-1, keepdim=True).clamp_min(1.0)
