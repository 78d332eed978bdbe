"""Laws of the tank beyond the paper's: braking that refills it, and damping that always passes."""

from __future__ import annotations

import torch
from torch import Tensor

from ppt_rl.functional.checks import require_finite
from ppt_rl.functional.tank_inertia import accelerating_power, coupling, require_inertia_of, signed_root
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
    inertia: Tensor | None = None,
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
        inertia: M, a lower bound of the inertia: ``(N,)`` by axis, positive, or a positive definite matrix ``(N, N)``
            or ``(*B, N, N)`` [kg, kg m^2]; None looks at the beginning of the step only.

    Returns:
        Valve, next level and scaled power, negative where energy is returned; with an inertia its mean over the step.

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
    if inertia is None:
        valve = torch.where(p < 0, 1.0, valve_for(p, fits, energy, p_max=p_max, dt=dt, eps=eps, ulp=ulp))
        power, is_paid = valve * p, p > 0
    else:
        gain = _gain(effort, inertia, dt, ulp)
        valve = _valve_ahead(p, gain, fits, energy, p_max=p_max, dt=dt, eps=eps, ulp=ulp)
        valve, power = _payable(valve, p, gain, ulp)
        is_paid = power > 0
    paid, kept = power * dt, energy * (1 - ulps)  # [J]
    gained = torch.threshold(-paid, tiny / ulps, 0.0) * (1 - ulps)
    level = torch.where(is_paid, kept - paid * (1 + ulps), torch.maximum(energy, kept + gained))
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
    inertia: Tensor | None = None,
) -> EnergyTankStep:
    r"""A valve on the active part of an effort only; damping passes beside it, whatever the level.

    With ``effort = active + damping``, what is executed is ``damping + valve * active``, and

    .. math::
        \gamma &= \min\Big(1,\ \frac{P_{max}}{\max(\epsilon, p)},\ \frac{E}{\Delta t \max(\epsilon, p)}\Big),
        \quad p = |\mathrm{active} \cdot \mathrm{flow}| \\
        E' &= \mathrm{clip}(E - \gamma\, p\, \Delta t,\ 0,\ E_{max})

    Damping takes energy out of the motion, ``damping . flow <= 0``, so nobody has to pay for it, and an empty tank
    brakes. A damping for which that does not surely hold counts as active. Hence, for finite inputs whose products do
    not underflow, the stored numbers satisfy, evaluated exactly,

    * ``valve |active . flow| <= p_max``, and ``executed . flow <= p_max``; the power of braking has no limit;
    * over an episode ``sum valve |active . flow| dt <= E_0 - E``, and ``sum executed . flow dt <= E_0 - E``: the net
      energy delivered is at most what the tank has lost.

    That is the power at the beginning of a step. With ``inertia`` the law looks ahead as
    :func:`~ppt_rl.functional.tank_ahead.rate_tank` does. As much of the damping passes as brakes until the end of the
    step, the share ``min(1, -damping . flow / (damping . M^{-1} damping dt))``, and the valve on the rest counts what
    both do to the velocity:

    .. math::
        \gamma\, (\mathrm{active} \cdot \mathrm{flow} + 2\, c\, \Delta t) + \gamma^2 a\, \Delta t
        \le \min(P_{max},\ E / \Delta t)

    with ``c = damping . M^{-1} active`` and ``a = active . M^{-1} active``, besides the limits above. The level pays
    ``max(p, active . flow + c dt + valve a dt / 2)`` in place of p. Then the bounds of what is executed hold for its
    power at every time of the step and every inertia of at least M, and for the integral of that power.

    Args:
        effort: ``(*B, N)`` nominal effort, damping included: wrench [N, N m] or joint torque [N m].
        flow: ``(*B, N)`` the velocity it works on: twist [m/s, rad/s] or joint velocity [rad/s].
        energy: ``(*B, 1)`` level of the tank [J].
        p_max: power limit [W]; a number, or ``(*B, 1)`` where it is given per step.
        e_max: capacity of the tank [J], likewise; one below the level clips it before the step.
        dt: control step [s].
        eps: smallest power that is divided by [W].
        damping: ``(*B, N)`` the part of the effort that brakes, such as ``-D twist``.
        inertia: M, a lower bound of the inertia: ``(N,)`` by axis, positive, or a positive definite matrix ``(N, N)``
            or ``(*B, N, N)`` [kg, kg m^2]; None looks at the beginning of the step only.

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
    damping = dissipative_part(damping, flow, inertia=inertia, dt=dt)
    active = effort - damping
    finite = active.isfinite().all(-1, keepdim=True)
    active = torch.where(finite, active, 0.0)
    p, fits = upper_power(active, flow, energy, ulp, roundings=8)
    fits = finite if fits is None else fits & finite
    valve = valve_for(p, fits, energy, p_max=p_max, dt=dt, eps=eps, ulp=ulp)
    if inertia is None:
        return settled(valve, valve * p, p > 0, energy, e_max=e_max, dt=dt, ulp=ulp)
    begin, _ = upper_power(active, flow, energy, ulp, signed=True, roundings=8)
    gain, cross = _gain(active, inertia, dt, 5 * ulp), _cross(damping, active, inertia, dt, ulp)
    ahead = _valve_ahead(begin + 2 * cross, gain, fits, energy, p_max=p_max, dt=dt, eps=eps, ulp=ulp)
    valve, power = _payable(torch.minimum(valve, ahead), begin + cross, gain, ulp, least=p)
    return settled(valve, power, power > 0, energy, e_max=e_max, dt=dt, ulp=ulp)


def dissipative_part(damping: Tensor, flow: Tensor, *, inertia: Tensor | None = None, dt: float = 0.0) -> Tensor:
    r"""As much of a damping as surely takes energy out of the motion, rounding included.

    That is all of it or, where ``damping . flow`` may be positive, nothing. With an inertia the damping has to brake
    until the end of the control step, so a damping that is strong enough to reverse the motion is scaled by

    .. math:: \min\Big(1,\ \frac{-\mathrm{damping} \cdot \mathrm{flow}}
        {\mathrm{damping}^\top M^{-1} \mathrm{damping}\, \Delta t}\Big)

    A damping that was scaled once is returned as it is.

    Args:
        damping: ``(*B, N)`` effort that should brake.
        flow: ``(*B, N)`` the velocity it works on.
        inertia: M, ``(N,)`` by axis or a matrix ``(*B, N, N)`` [kg, kg m^2]; None looks at the beginning of the step.
        dt: control step [s].

    Returns:
        ``(*B, N)`` with ``damping . flow <= 0``; with an inertia ``damping . (flow + M^-1 damping dt) <= 0``.

    Raises:
        ValueError: if the damping is not finite or has another shape than the velocity, or the inertia does not fit.
    """
    if damping.shape != flow.shape:
        raise ValueError(
            f"damping has shape {tuple(damping.shape)}; expected that of the velocity it works on, "
            f"{tuple(flow.shape)}. Carry it to the space of the effort, or leave it out."
        )
    require_finite("damping", damping)
    terms, ulp = damping * flow, coarsest(damping.dtype, flow.dtype)
    share = 0.5 * (terms.shape[-1] + (12 if inertia is None else 32)) * ulp
    upper = torch.add(terms.sum(-1, keepdim=True), terms.abs().sum(-1, keepdim=True), alpha=share)
    if inertia is None:
        return torch.where(upper <= 0, damping, 0.0)
    gain = _gain(damping, inertia, dt, 16 * ulp)
    usual = (upper <= 0) & gain.isfinite() & (gain >= 0)
    much = gain > -upper
    scaled = damping * (-upper / torch.where(much, gain, 1.0) * (1 - 64 * ulp))
    return torch.where(usual, torch.where(much, scaled, damping), 0.0)


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


def _gain(effort: Tensor, inertia: Tensor, dt: float, ulp: float) -> Tensor:
    """What an effort adds to its own power in a control step ``(*B, 1)`` [W], rounded up."""
    require_inertia_of(effort, inertia)
    return accelerating_power(effort, inertia, ulp) * (dt * (1 + 2 * ulp))


def _cross(damping: Tensor, active: Tensor, inertia: Tensor, dt: float, ulp: float) -> Tensor:
    """What damping and the active part add to each other's power in a control step ``(*B, 1)`` [W], rounded up."""
    sizes = [accelerating_power(part, inertia, ulp).clamp_min(0.0).sqrt() for part in (damping, active)]
    doubt = sizes[0] * sizes[1] * ((damping.shape[-1] + 20) * ulp)
    return coupling(damping, active, inertia, doubt) * dt


def _valve_ahead(
    b: Tensor, gain: Tensor, fits: Tensor | None, energy: Tensor, *, p_max: float | Tensor, dt: float, eps: float,
    ulp: float,
) -> Tensor:  # fmt: skip
    """The largest valve in [0, 1] with ``valve b + valve^2 gain`` within limit and level ``(*B, 1)``, rounded down."""
    tiny, ulps = torch.finfo(energy.dtype).tiny, 32 * ulp
    usable = torch.threshold(energy, tiny / ulps, 0.0)  # [J]
    limit = (usable / dt).clamp_max(p_max)
    usual = (b * b + 4 * limit * gain).isfinite() & (gain >= 0)
    usual = usual if fits is None else usual & fits
    b, gain = torch.where(usual, b, 0.0), torch.where(usual, gain, 0.0)
    valve = (signed_root(b, gain, limit, eps) * (1 - ulps)).clamp_max(1.0) * usual
    return torch.threshold(valve, tiny, 0.0)


def _payable(
    valve: Tensor, begin: Tensor, gain: Tensor, ulp: float, least: Tensor | None = None
) -> tuple[Tensor, Tensor]:
    """Valve and mean power over the step, rounded up, at least that of ``least``; what is too small does not pass."""
    half = 0.5 * valve * gain
    power = torch.add(begin + half, begin.abs() + half, alpha=4 * ulp)
    power = valve * (power if least is None else torch.maximum(power, least))
    passes = (valve > 0) & ((power.abs() >= torch.finfo(power.dtype).tiny) | (begin.abs() + gain == 0))
    return torch.where(passes, valve, 0.0), torch.where(passes, power, 0.0)
