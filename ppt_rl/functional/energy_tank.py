"""The energy tank: a budget of power and energy that scales an effort, and the registry of its laws."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from torch import Tensor

from ppt_rl.functional.constants import constant
from ppt_rl.functional.tank_ahead import impact_tank, rate_tank
from ppt_rl.functional.tank_laws import parallel_tank, passive_tank
from ppt_rl.functional.tank_step import EnergyTankStep, TankLaw, budgets, coarsest, settled, upper_power, valve_for

__all__ = ["TANK_LAWS", "EnergyTankStep", "TankLaw", "energy_tank", "law_reads"]


def energy_tank(
    effort: Tensor,
    flow: Tensor,
    energy: Tensor,
    *,
    p_max: float | Tensor,
    e_max: float | Tensor,
    dt: float,
    eps: float = 1e-6,
) -> EnergyTankStep:
    r"""The paper's law: the valve limits ``p = |effort . flow|``, and the tank pays for what passes.

    .. math::
        \gamma &= \min\Big(1,\ \frac{P_{max}}{\max(\epsilon, p)},\ \frac{E}{\Delta t \max(\epsilon, p)}\Big) \\
        E' &= \mathrm{clip}(E - \gamma\, p\, \Delta t,\ 0,\ E_{max})

    Floating-point numbers are rounded to the safe side. Where large terms of a power cancel, its rounding error may
    exceed the limit itself, so the law adds a bound on that error:

    .. math:: p = |\mathrm{effort} \cdot \mathrm{flow}|
        + \tfrac12 (N + 3)\,u\,\textstyle\sum_i |\mathrm{effort}_i\,\mathrm{flow}_i|

    with ``u`` the distance from 1 to the next number of the coarsest input. Hence, for every finite input, the stored
    numbers satisfy ``|(valve * effort) . flow| <= p_max``, and over an episode ``sum |(valve * effort) . flow| dt <=
    E_0``, evaluated exactly. A power too large for the format, a valve that is subnormal (it has too few digits) and a
    level that is subnormal all close the valve.

    Args:
        effort: ``(*B, N)`` nominal effort: wrench [N, N m] or joint torque [N m].
        flow: ``(*B, N)`` the velocity it works on: twist [m/s, rad/s] or joint velocity [rad/s].
        energy: ``(*B, 1)`` level of the tank [J].
        p_max: power limit [W]; a number, or ``(*B, 1)`` where it is given per step.
        e_max: capacity of the tank [J], likewise; one below the level clips it before the step.
        dt: control step [s].
        eps: smallest power that is divided by [W].

    Returns:
        Valve, next level and scaled power.

    Raises:
        ValueError: if effort, flow, level or a limit is not finite, or a shape does not fit; what is finite is not
            checked inside ``torch.vmap`` and ``torch.compile``.

    Source:
        Paper, eq. (10) (problem definition) and section "Energy-Tank Layer for Safe Execution".
    """
    ulp = coarsest(effort.dtype, flow.dtype, energy.dtype)
    energy, p_max, e_max = budgets(energy, p_max, e_max)
    p, fits = upper_power(effort, flow, energy, ulp)
    valve = valve_for(p, fits, energy, p_max=p_max, dt=dt, eps=eps, ulp=ulp)
    return settled(valve, valve * p, p > constant(0.0, p), energy, e_max=e_max, dt=dt, ulp=ulp)


#: The laws of the tank by name: the values of ``mode`` that an ``EnergyTankTransform`` accepts.
TANK_LAWS: dict[str, TankLaw] = {
    "paper": energy_tank,
    "passive": passive_tank,
    "parallel": parallel_tank,
    "rate": rate_tank,
    "impact": impact_tank,
}


def law_reads(law: Callable[..., Any], *, needed: bool = False) -> frozenset[str]:
    """What a law reads besides effort, flow, level and limits, as its signature says.

    Args:
        law: the law.
        needed: leave out what has a default.

    Returns:
        Those of ``"damping"``, ``"inertia"`` and ``"stored"`` that are among its arguments.
    """
    arguments = inspect.signature(law).parameters
    known = {"damping", "inertia", "stored"} & set(arguments)
    return frozenset(name for name in known if not needed or arguments[name].default is inspect.Parameter.empty)
