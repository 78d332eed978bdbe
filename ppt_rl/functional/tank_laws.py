"""Laws of the tank beyond the paper's: braking that refills it, and damping that always passes."""

from __future__ import annotations

import torch
from torch import Tensor

from ppt_rl.functional.checks import require_finite
from ppt_rl.functional.tank_step import (
    EnergyTankStep,
    as_level,
    budgets,
    coarsest,
    settled,
    upper_power,
    valve_for,
    within,
)

__all__ = ["beside", "dissipative_part", "parallel_tank", "passive_tank"]


def passive_tank(
    effort: Tensor,
    flow: Tensor,
    energy: Tensor,
    *,
    p_max: float | Tensor,
    e_max: float | Tensor,
    dt: float,
    eps: float = 1e-6,
) -> EnergyTankStep:
    r"""A law with a sign: pushing is limited and paid for, braking passes whole and refills the tank.

    With ``p = effort . flow``, positive where energy leaves the robot:

    .. math::
        \gamma &= \begin{cases} 1 & p < 0 \\
            \min\Big(1,\ \frac{P_{max}}{\max(\epsilon, p)},\ \frac{E}{\Delta t \max(\epsilon, p)}\Big) & p \ge 0
            \end{cases} \\
        E' &= \mathrm{clip}(E - \gamma\, p\, \Delta t,\ 0,\ E_{max})

    So an empty tank can brake. It is rounded to the safe side as the paper's law is
    (:func:`~ppt_rl.functional.energy_tank.energy_tank`): ``p`` is the sum plus a bound on its rounding error. Where
    that bound leaves the sign open, the effort counts as pushing, and what is not surely returned refills nothing.
    Hence, for finite inputs whose products do not underflow, the stored numbers satisfy, evaluated exactly,

    * ``(valve * effort) . flow <= p_max``; the power of braking has no limit;
    * over an episode ``sum (valve * effort) . flow dt <= E_0 - E``: the net energy delivered is at most what the tank
      has lost, and never more than ``E_0``. Energy above ``e_max`` is lost. The sum of the absolute values, work with
      braking counted like pushing, has no limit: what is returned can be delivered again.

    Args:
        effort: ``(*B, N)`` nominal effort: wrench [N, N m] or joint torque [N m].
        flow: ``(*B, N)`` the velocity it works on: twist [m/s, rad/s] or joint velocity [rad/s].
        energy: ``(*B, 1)`` level of the tank [J].
        p_max: power limit [W]; a number, or ``(*B, 1)`` where it is given per step.
        e_max: capacity of the tank [J], likewise; one below the level clips it before the step.
        dt: control step [s].
        eps: smallest power that is divided by [W].

    Returns:
        Valve, next level and scaled power, negative where energy is returned.

    Raises:
        ValueError: if effort, flow, level or a limit is not finite, or a shape does not fit.

    Source:
        Ferraguti, Secchi, Fantuzzi 2013, "A tank-based approach to impedance control with variable stiffness", for the
        tank that dissipated energy refills; the limits are the paper's, eq. (10).
    """
    ulp = coarsest(effort.dtype, flow.dtype, energy.dtype)
    energy, p_max, e_max = budgets(energy, p_max, e_max)
    p, fits = upper_power(effort, flow, energy, ulp, signed=True)
    tiny, ulps = torch.finfo(energy.dtype).tiny, 4 * ulp
    valve = torch.where(p < 0, 1.0, valve_for(p, fits, energy, p_max=p_max, dt=dt, eps=eps, ulp=ulp))
    power = valve * p
    paid, kept = power * dt, energy * (1 - ulps)  # [J]
    gained = torch.threshold(-paid, tiny / ulps, 0.0) * (1 - ulps)
    level = torch.where(p > 0, kept - paid * (1 + ulps), torch.maximum(energy, kept + gained))
    return as_level(EnergyTankStep(valve, within(level, e_max), power), energy)


def parallel_tank(
    effort: Tensor,
    flow: Tensor,
    energy: Tensor,
    *,
    p_max: float | Tensor,
    e_max: float | Tensor,
    dt: float,
    eps: float = 1e-6,
    damping: Tensor,
) -> EnergyTankStep:
    r"""A valve on the active part of an effort only; damping passes beside it, whatever the level.

    With ``effort = active + damping``, what is executed is ``damping + valve * active`` (:func:`beside`), and

    .. math::
        \gamma &= \min\Big(1,\ \frac{P_{max}}{\max(\epsilon, p)},\ \frac{E}{\Delta t \max(\epsilon, p)}\Big),
        \quad p = |\mathrm{active} \cdot \mathrm{flow}| \\
        E' &= \mathrm{clip}(E - \gamma\, p\, \Delta t,\ 0,\ E_{max})

    Damping takes energy out of the motion, ``damping . flow <= 0``, so nobody has to pay for it, and an empty tank
    brakes. A damping for which that does not surely hold counts as active (:func:`dissipative_part`). Hence, for finite
    inputs whose products do not underflow, the stored numbers satisfy, evaluated exactly,

    * ``valve |active . flow| <= p_max``, and ``executed . flow <= p_max``; the power of braking has no limit;
    * over an episode ``sum valve |active . flow| dt <= E_0 - E``, and ``sum executed . flow dt <= E_0 - E``: the net
      energy delivered is at most what the tank has lost.

    Args:
        effort: ``(*B, N)`` nominal effort, damping included: wrench [N, N m] or joint torque [N m].
        flow: ``(*B, N)`` the velocity it works on: twist [m/s, rad/s] or joint velocity [rad/s].
        energy: ``(*B, 1)`` level of the tank [J].
        p_max: power limit [W]; a number, or ``(*B, 1)`` where it is given per step.
        e_max: capacity of the tank [J], likewise; one below the level clips it before the step.
        dt: control step [s].
        eps: smallest power that is divided by [W].
        damping: ``(*B, N)`` the part of the effort that brakes, such as ``-D twist``.

    Returns:
        Valve, next level and power of the scaled active part.

    Raises:
        ValueError: if effort, flow, level, damping or a limit is not finite, or a shape does not fit.

    Source:
        The paper's law, eq. (10), with the damping of its eq. (5) beside the valve.
    """
    ulp = coarsest(effort.dtype, flow.dtype, energy.dtype, damping.dtype)
    energy, p_max, e_max = budgets(energy, p_max, e_max)
    require_finite("effort", effort)
    active = effort - dissipative_part(damping, flow)
    finite = active.isfinite().all(-1, keepdim=True)
    p, fits = upper_power(torch.where(finite, active, 0.0), flow, energy, ulp, roundings=8)
    fits = finite if fits is None else fits & finite
    valve = valve_for(p, fits, energy, p_max=p_max, dt=dt, eps=eps, ulp=ulp)
    return settled(valve, valve * p, p > 0, energy, e_max=e_max, dt=dt, ulp=ulp)


def dissipative_part(damping: Tensor, flow: Tensor) -> Tensor:
    """A damping where it surely takes energy out of the motion, rounding included, and zero where it may not.

    Args:
        damping: ``(*B, N)`` effort that should brake.
        flow: ``(*B, N)`` the velocity it works on.

    Returns:
        ``(*B, N)`` with ``damping . flow <= 0``.

    Raises:
        ValueError: if the damping is not finite or has another shape than the velocity.
    """
    if damping.shape != flow.shape:
        raise ValueError(
            f"damping has shape {tuple(damping.shape)}; expected that of the velocity it works on, "
            f"{tuple(flow.shape)}. Carry it to the space of the effort, or leave it out."
        )
    require_finite("damping", damping)
    terms = damping * flow
    share = 0.5 * (terms.shape[-1] + 12) * coarsest(damping.dtype, flow.dtype)
    upper = torch.add(terms.sum(-1, keepdim=True), terms.abs().sum(-1, keepdim=True), alpha=share)
    return torch.where(upper <= 0, damping, 0.0)


def beside(valve: Tensor, effort: Tensor, damping: Tensor) -> Tensor:
    """What is executed where damping passes beside the valve: ``damping + valve * (effort - damping)``.

    It is computed as ``valve * effort + (1 - valve) * damping``, so an open valve leaves the effort exactly as it is.

    Args:
        valve: ``(*B, 1)`` factor on the active part [-].
        effort: ``(*B, N)`` nominal effort, damping included.
        damping: ``(*B, N)`` its part that passes.

    Returns:
        ``(*B, N)``.
    """
    return valve * effort + (1 - valve) * damping
