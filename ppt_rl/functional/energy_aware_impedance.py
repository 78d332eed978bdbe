"""An impedance whose energy and power are bounded: a softer spring, and a stronger damper."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ppt_rl.functional.checks import require_last_dim
from ppt_rl.functional.impedance import power
from ppt_rl.functional.shape_checks import require_same_batch

__all__ = ["PowerFactors", "damping_factor", "kinetic_energy", "spring_energy", "stiffness_factor"]


class PowerFactors(NamedTuple):
    """What bounds the power of an impedance.

    Attributes:
        damping: ``(*B, 1)`` factor on the damping, at least 1 (beta).
        drive: ``(*B, 1)`` factor on the drive in [0, 1]; 1 wherever the damping alone is enough.
    """

    damping: Tensor
    drive: Tensor


def spring_energy(error: Tensor, stiffness: Tensor) -> Tensor:
    r"""Energy of the virtual spring, :math:`V = \tfrac12 e^\top K e`.

    Args:
        error: ``(*B, 6)`` position error [m] and orientation error [-].
        stiffness: ``(*B, 6)`` diagonal of K [N/m, N m/rad].

    Returns:
        ``(*B, 1)`` energy [J].

    Raises:
        ValueError: if a shape does not fit.
    """
    require_last_dim("error", error, 6)
    require_last_dim("stiffness", stiffness, 6)
    require_same_batch(error=error, stiffness=stiffness)
    return 0.5 * (stiffness * error.square()).sum(-1, keepdim=True)


def kinetic_energy(twist: Tensor, inertia: Tensor) -> Tensor:
    r"""Kinetic energy of the end effector, :math:`T = \tfrac12 \nu^\top M \nu`.

    Args:
        twist: ``(*B, 6)`` [m/s, rad/s].
        inertia: ``(*B, 6)`` diagonal of M, the apparent inertia [kg, kg m^2].

    Returns:
        ``(*B, 1)`` energy [J].

    Raises:
        ValueError: if a shape does not fit.
    """
    require_last_dim("twist", twist, 6)
    require_last_dim("inertia", inertia, 6)
    require_same_batch(twist=twist, inertia=inertia)
    return 0.5 * (inertia * twist.square()).sum(-1, keepdim=True)


def stiffness_factor(kinetic: Tensor, potential: Tensor, e_max: float) -> Tensor:
    r"""Factor on the stiffness that keeps the total energy within a budget.

    .. math:: \lambda = \begin{cases} 1 & T + V \le E_{max} \\
        \mathrm{clip}\big((E_{max} - T) / V,\ 0,\ 1\big) & \text{otherwise} \end{cases}

    Hence ``lambda V <= max(0, E_max - T)``: the energy of the scaled spring and of the motion together is at most
    ``E_max`` wherever the motion alone is, and elsewhere there is no spring. A tool at rest is pressed with at most
    ``sqrt(2 k E_max)`` along an axis of stiffness ``k``, because ``lambda k |e| = sqrt(2 lambda k (lambda V))``;
    beyond that, a reference that is farther away presses less.

    Args:
        kinetic: ``(*B, 1)`` T [J].
        potential: ``(*B, 1)`` V, with the unscaled stiffness [J].
        e_max: budget [J].

    Returns:
        ``(*B, 1)`` factor in [0, 1].

    Raises:
        ValueError: if a shape does not fit.

    Source:
        Raiola et al. 2018, "Development of a safety- and energy-aware impedance controller for collaborative robots",
        IEEE Robotics and Automation Letters 3(2), section "Energy regulation".
    """
    require_last_dim("kinetic", kinetic, 1)
    require_last_dim("potential", potential, 1)
    require_same_batch(kinetic=kinetic, potential=potential)
    fits = kinetic + potential <= e_max
    divided = ~fits & (potential > torch.finfo(potential.dtype).tiny)
    left = (e_max - kinetic).clamp_min(0.0) * (1 - 4 * torch.finfo(potential.dtype).eps)
    share = left / torch.where(divided, potential, 1.0)
    return torch.where(fits, 1.0, share.clamp(0.0, 1.0))


def damping_factor(drive: Tensor, twist: Tensor, damping: Tensor, p_max: float, most: Tensor) -> PowerFactors:
    r"""Factor on the damping, and where that is at its bound on the drive, that keep the power within a limit.

    .. math::
        \beta &= \mathrm{clip}\Big(\frac{f \cdot \nu - P_{max}}{\nu^\top D\, \nu},\ 1,\ \beta_{max}\Big), \\
        \mu &= \min\Big(1,\ \frac{P_{max} + \beta\, \nu^\top D\, \nu}{f \cdot \nu}\Big)

    Hence ``(mu f - beta D nu) . nu <= P_max`` for the velocity given, in both branches. The bound on ``beta`` is for
    stability: a damping that is too large for the control step turns the velocity around and makes the arm chatter
    (:func:`~ppt_rl.functional.stability.largest_damping_factor`). With it alone, the power would exceed the limit by
    ``f . nu - beta_max nu^T D nu - P_max``; ``mu`` takes that off the drive.

    Args:
        drive: ``(*B, 6)`` f, the wrench of spring and feed-forward [N, N m].
        twist: ``(*B, 6)`` measured, nu [m/s, rad/s].
        damping: ``(*B, 6)`` diagonal of D [N s/m, N m s/rad].
        p_max: largest power towards the world [W].
        most: ``(*B, 1)`` beta_max, at least 1.

    Returns:
        Factors on damping and drive.

    Raises:
        ValueError: if a shape does not fit.

    Source:
        Raiola et al. 2018, section "Power regulation", for beta; its bound and mu are ours.
    """
    for name, value, size in (("drive", drive, 6), ("twist", twist, 6), ("damping", damping, 6), ("most", most, 1)):
        require_last_dim(name, value, size)
    require_same_batch(drive=drive, twist=twist, damping=damping, most=most)
    given = power(drive, twist)
    taken = power(damping * twist, twist)
    above = (given - taken > p_max) & (taken > torch.finfo(taken.dtype).tiny)
    wanted = torch.where(above, (given - p_max) / torch.where(above, taken, 1.0), 1.0)
    beta = torch.minimum(wanted.clamp_min(1.0), most)
    capped = given - beta * taken > p_max
    share = (p_max + beta * taken) / torch.where(capped, given, 1.0)
    return PowerFactors(beta, torch.where(capped & (wanted > beta), share.clamp(0.0, 1.0), 1.0))
