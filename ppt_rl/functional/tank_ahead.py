"""Laws of the tank that look ahead: they bound the power over the whole control step for which an effort is held."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ppt_rl.functional.checks import require_last_dim
from ppt_rl.functional.shape_checks import require_same_batch
from ppt_rl.functional.tank_inertia import accelerating_power, kinetic_energy, require_inertia_of, root
from ppt_rl.functional.tank_step import EnergyTankStep, budgets, coarsest, settled, upper_power

__all__ = ["impact_tank", "rate_tank", "recent_motion"]

#: Time in which the energy that contact may hold is forgotten, to a share of 1/e [s].
_CONTACT_TIME = 0.1


def rate_tank(
    effort: Tensor,
    flow: Tensor,
    energy: Tensor,
    *,
    p_max: float | Tensor,
    e_max: float | Tensor,
    dt: float,
    eps: float = 1e-6,
    inertia: Tensor,
) -> EnergyTankStep:
    r"""A law that looks ahead: it bounds the power of an effort at every moment of the step over which it is held.

    An effort accelerates what it works on. While ``valve * effort`` is held, the flow after a time t is ``flow +
    A^{-1} valve effort t``, where the inertia A is at least M. So its power is at most

    .. math:: \gamma\, p + \gamma^2\, t\, a, \qquad p = |\mathrm{effort} \cdot \mathrm{flow}|,
        \quad a = \mathrm{effort}^\top M^{-1} \mathrm{effort}

    and its work at most ``gamma p dt + gamma^2 a dt^2 / 2``. The valve is the largest for which the first stays below
    the limit at the end of the step, and the second below the level:

    .. math::
        \gamma &= \min\Big(1,\ r(P_{max};\ p,\ a \Delta t),\ r\big(E / \Delta t;\ p,\ \tfrac12 a \Delta t\big)\Big),
        \qquad r(P; b, c) = \frac{2 P}{\max(2\epsilon,\ b + \sqrt{b^2 + 4 P c})} \\
        E' &= \mathrm{clip}\big(E - (\gamma\, p + \tfrac12 \gamma^2 a \Delta t)\, \Delta t,\ 0,\ E_{max}\big)

    Hence, for finite inputs whose products do not underflow, the stored numbers satisfy, evaluated exactly for an
    inertia M that is given by axis,

    * ``|(valve effort) . (flow + A^{-1} valve effort t)| <= p_max`` for every t in [0, dt] and every A of at least M,
      in particular the bound of the paper's law, that for t = 0;
    * over an episode, the sum of the integrals of that power over the steps is at most ``E_0``.

    With a matrix, the same holds up to the rounding of a solution in double precision. What else accelerates, such as
    contact, gravity or Coriolis forces, is beyond the law.

    Args:
        effort: ``(*B, N)`` nominal effort: wrench [N, N m] or joint torque [N m].
        flow: ``(*B, N)`` the velocity it works on: twist [m/s, rad/s] or joint velocity [rad/s].
        energy: ``(*B, 1)`` level of the tank [J].
        p_max: power limit [W]; a number, or ``(*B, 1)`` where it is given per step.
        e_max: capacity of the tank [J], likewise; one below the level clips it before the step.
        dt: control step [s].
        eps: smallest power that is divided by [W].
        inertia: M, a lower bound of the inertia: ``(N,)`` by axis, positive, or a positive definite matrix ``(N, N)``
            or ``(*B, N, N)`` [kg, kg m^2].

    Returns:
        Valve, next level and worst mean power over the step.

    Raises:
        ValueError: if effort, flow, level or a limit is not finite, or a shape does not fit.

    Source:
        The paper's law, eq. (10), with the velocity within the step; the roots of the quadratic are ours.
    """
    return _look_ahead(effort, flow, energy, inertia, p_max=p_max, e_max=e_max, dt=dt, eps=eps)


def impact_tank(
    effort: Tensor,
    flow: Tensor,
    energy: Tensor,
    *,
    p_max: float | Tensor,
    e_max: float | Tensor,
    dt: float,
    eps: float = 1e-6,
    inertia: Tensor,
    stored: Tensor | None = None,
) -> EnergyTankStep:
    r"""A law for impacts: it bounds the power of an effort whatever passive contact does to the velocity in the step.

    An impact turns a velocity round within milliseconds, and an effort that braked then drives. But contact with what
    is at rest and holds no energy adds no kinetic energy, and neither do Coriolis and centrifugal forces. In the norm
    of the inertia, ``|v|_M = sqrt(v^T M v)``, the speed grows by the effort alone, and no effort has more power than
    the product of the norms (Cauchy-Schwarz). While ``valve * effort`` is held, its power after a time t is at most

    .. math:: \gamma\, s\, (k + \gamma\, s\, t), \qquad
        s = \sqrt{\mathrm{effort}^\top M^{-1} \mathrm{effort}}, \quad
        k = \max\big(\sqrt{\mathrm{flow}^\top M\, \mathrm{flow}},\ \sqrt{2 E_s}\big)

    where ``E_s`` is energy that contact holds and may give back, such as a wall that springs back one step after it was
    hit (:func:`recent_motion`). The valve keeps this below the limit at the end of the step. The level pays as in
    :func:`rate_tank`, whose ``r`` and ``p`` stand here too:

    .. math::
        \gamma &= \min\Big(1,\ r(P_{max};\ s k,\ s^2 \Delta t),\
            r\big(E / \Delta t;\ p,\ \tfrac12 s^2 \Delta t\big)\Big),
        \qquad r(P; b, c) = \frac{2 P}{\max(2\epsilon,\ b + \sqrt{b^2 + 4 P c})} \\
        E' &= \mathrm{clip}\big(E - (\gamma\, p + \tfrac12 \gamma^2 s^2 \Delta t)\, \Delta t,\ 0,\ E_{max}\big)

    Hence, for finite inputs whose products do not underflow, the stored numbers satisfy, evaluated exactly for an
    inertia M that is given by axis,

    * ``|(valve effort) . v| <= p_max`` for every velocity v with ``|v|_M <= k + valve s dt``, so at every moment of the
      step, whether contact stops, deflects or reverses the motion; the bounds of ``rate`` and of the paper's law on the
      power are special cases;
    * over an episode, the sum of the integrals of the power over the steps is at most ``E_0`` where nothing but the
      effort changes the velocity; a step in which contact or a Coriolis force does may work up to ``p_max dt``,
      whatever it has paid.

    With a matrix, the same holds up to the rounding of a solution in double precision. M is the inertia itself here,
    not only a lower bound: where the true one is between M and ``c M``, the bound is ``sqrt(c) p_max``. Energy from
    elsewhere is beyond the law: a body that runs into the robot, gravity that is not compensated, and a spring that the
    robot has loaded slowly and that lets go.

    Args:
        effort: ``(*B, N)`` nominal effort: wrench [N, N m] or joint torque [N m].
        flow: ``(*B, N)`` the velocity it works on: twist [m/s, rad/s] or joint velocity [rad/s].
        energy: ``(*B, 1)`` level of the tank [J].
        p_max: power limit [W]; a number, or ``(*B, 1)`` where it is given per step.
        e_max: capacity of the tank [J], likewise; one below the level clips it before the step.
        dt: control step [s].
        eps: smallest power that is divided by [W].
        inertia: M: ``(N,)`` by axis, positive, or a positive definite matrix ``(N, N)`` or ``(*B, N, N)``
            [kg, kg m^2].
        stored: ``(*B, 1)`` energy E_s that contact may hold [J]; None for none.

    Returns:
        Valve, next level and worst mean power over a step in which nothing is hit.

    Raises:
        ValueError: if effort, flow, level or a limit is not finite, or a shape does not fit.

    Source:
        Ours.
    """
    if stored is not None:
        require_last_dim("stored", stored, 1)
        require_same_batch(flow=flow, stored=stored)
    contact = torch.zeros_like(energy) if stored is None else stored
    return _look_ahead(effort, flow, energy, inertia, p_max=p_max, e_max=e_max, dt=dt, eps=eps, contact=contact)


def recent_motion(flow: Tensor, inertia: Tensor, before: Tensor | None, *, dt: float) -> Tensor:
    r"""Kinetic energy of the recent motion, which contact may have taken and may give back.

    .. math:: E_s' = \max\big(\tfrac12 \mathrm{flow}^\top M\, \mathrm{flow},\ e^{-\Delta t / T} E_s\big), \qquad
        T = 0.1\ \mathrm{s}

    A spring that stops the robot has its kinetic energy a few milliseconds later, when nothing moves. Where contact
    gives it back after a time t, the speed that :func:`impact_tank` counts with is too low by the factor
    ``exp(-t / 2T)``, 10 % after 20 ms. What an effort puts into a spring slowly is not counted.

    Args:
        flow: ``(*B, N)`` velocity [m/s, rad/s].
        inertia: M: ``(N,)`` by axis or a matrix ``(*B, N, N)`` [kg, kg m^2].
        before: ``(*B, 1)`` the result for the previous control step [J]; None at the start.
        dt: control step [s].

    Returns:
        ``(*B, 1)`` energy [J].

    Raises:
        ValueError: if a shape does not fit.

    Source:
        Ours.
    """
    require_inertia_of(flow, inertia)
    kinetic = kinetic_energy(flow, inertia)
    if before is not None:
        require_last_dim("before", before, 1)
        require_same_batch(flow=flow, before=before)
    return kinetic if before is None else torch.maximum(kinetic, before * math.exp(-dt / _CONTACT_TIME))


def _look_ahead(
    effort: Tensor,
    flow: Tensor,
    energy: Tensor,
    inertia: Tensor,
    *,
    p_max: float | Tensor,
    e_max: float | Tensor,
    dt: float,
    eps: float,
    contact: Tensor | None = None,
) -> EnergyTankStep:
    """Both laws. Without ``contact`` [J] it bounds the power of the velocity, with it the largest of any direction."""
    ulp = coarsest(effort.dtype, flow.dtype, energy.dtype)
    require_inertia_of(effort, inertia)
    energy, p_max, e_max = budgets(energy, p_max, e_max)
    p, fits = upper_power(effort, flow, energy, ulp)
    rise = accelerating_power(effort, inertia, ulp)  # s^2 [W/s]
    bounded = p if contact is None else _largest_power(rise, flow, inertia, contact, ulp)
    gain = rise * (dt * (1 + 2 * ulp))  # s^2 dt [W]
    usual = gain.isfinite() & (gain >= 0) & bounded.isfinite()
    fits = usual if fits is None else fits & usual
    gain, bounded = torch.where(fits, gain, 0.0), torch.where(fits, bounded, 0.0)
    tiny, ulps = torch.finfo(energy.dtype).tiny, 8 * ulp
    usable = torch.threshold(energy, tiny / ulps, 0.0)  # [J]
    by_power = root(bounded, gain, p_max, eps)
    by_level = root(p, 0.5 * gain, (usable / dt).clamp_max(p_max), eps)
    valve = torch.minimum(by_power, by_level) * fits * (1 - ulps)
    valve = torch.threshold(valve.clamp_max(1.0), tiny, 0.0)
    power = valve * (p + valve * (0.5 * gain))
    payable = (power >= tiny) | (p + gain == 0)  # what is too small to be paid does not pass
    valve, power = valve * payable, power * payable
    return settled(valve, power, power > 0, energy, e_max=e_max, dt=dt, ulp=2 * ulp)


def _largest_power(rise: Tensor, flow: Tensor, inertia: Tensor, contact: Tensor, ulp: float) -> Tensor:
    """``s k`` ``(*B, 1)`` [W], rounded up: the power if the effort drove the motion as well as it can."""
    energy = torch.maximum(kinetic_energy(flow, inertia), contact)
    return rise.clamp_min(0.0).sqrt() * (2 * energy).sqrt() * (1 + 0.5 * (flow.shape[-1] + 12) * ulp)
