"""The energy tank: a budget of power and energy that scales an effort, and the registry of its laws."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from ppt_rl.functional.checks import are_finite, require_finite

__all__ = ["TANK_LAWS", "EnergyTankStep", "TankLaw", "energy_tank"]


class EnergyTankStep(NamedTuple):
    """The result of one control step of a tank.

    Attributes:
        valve: ``(*B, 1)`` factor on the effort in [0, 1] (gamma in the paper).
        energy: ``(*B, 1)`` level of the tank after the step [J].
        power: ``(*B, 1)`` power of the scaled effort, rounding included: what the tank pays for [W].
    """

    valve: Tensor
    energy: Tensor
    power: Tensor


class TankLaw(Protocol):
    """A law of the tank: from effort, velocity and level to the valve in [0, 1] and the next level in [0, e_max].

    To add a law, write a function of this form and register it under a name::

        def shut(effort, flow, energy, *, p_max, e_max, dt, eps):
            return EnergyTankStep(torch.zeros_like(energy), energy, torch.zeros_like(energy))

        TANK_LAWS["shut"] = shut

    From then on ``EnergyTankTransform(mode="shut")`` runs it. The arguments are those of :func:`energy_tank`.
    """

    def __call__(
        self, effort: Tensor, flow: Tensor, energy: Tensor, *, p_max: float, e_max: float, dt: float, eps: float
    ) -> EnergyTankStep:
        """Execute one control step."""
        ...


def energy_tank(
    effort: Tensor, flow: Tensor, energy: Tensor, *, p_max: float, e_max: float, dt: float, eps: float = 1e-6
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
        p_max: power limit [W].
        e_max: capacity of the tank [J].
        dt: control step [s].
        eps: smallest power that is divided by [W].

    Returns:
        Valve, next level and scaled power.

    Raises:
        ValueError: if effort, flow or level is not finite; not checked inside ``torch.vmap`` and ``torch.compile``.

    Source:
        Paper, eq. (10) (problem definition) and section "Energy-Tank Layer for Safe Execution".
    """
    ulp = _coarsest(effort.dtype, flow.dtype, energy.dtype)
    p, fits = _power(effort, flow, energy, ulp)
    tiny, ulps = torch.finfo(energy.dtype).tiny, 4 * ulp
    usable = torch.threshold(energy, tiny / ulps, 0.0)  # [J]
    limit = (usable / dt).clamp_max(p_max) / p.clamp_min(eps)
    limit = limit if fits is None else limit * fits
    valve = torch.threshold((limit * (1 - ulps)).clamp_max(1.0), tiny, 0.0)
    power = valve * p
    level = torch.where(p > 0, energy * (1 - ulps), energy) - power * (dt * (1 + ulps))  # [J]
    step = EnergyTankStep(valve, level.clamp(0.0, e_max), power)
    return step if p.dtype == energy.dtype else EnergyTankStep(*(value.to(energy.dtype) for value in step))


@cache
def _coarsest(*dtypes: torch.dtype) -> float:
    """Distance from 1 to the next number in the coarsest of some formats."""
    return max(torch.finfo(dtype).eps for dtype in dtypes)


def _power(effort: Tensor, flow: Tensor, energy: Tensor, ulp: float) -> tuple[Tensor, Tensor | None]:
    """Power with a bound on its rounding error ``(*B, 1)`` [W], zero where it is too large for the format.

    The second value says where it fits; None stands for everywhere.
    """
    if effort.shape[-1:] != flow.shape[-1:] or energy.shape[-1:] != (1,):
        raise ValueError(
            f"effort is {tuple(effort.shape)}, flow {tuple(flow.shape)}, tank_energy {tuple(energy.shape)} in shape; "
            "expected effort and flow (*B, N) and a level (*B, 1)."
        )
    terms = effort * flow
    share = 0.5 * (terms.shape[-1] + 3) * ulp
    p = torch.add(terms.sum(-1, keepdim=True).abs(), terms.abs().sum(-1, keepdim=True), alpha=share)
    if are_finite(p + energy):  # then so are effort, flow and level
        return p, None
    for name, value in (("effort", effort), ("flow", flow), ("tank_energy", energy)):
        require_finite(name, value)
    fits = p.isfinite()
    return torch.where(fits, p, 0.0), fits


#: The laws of the tank by name: the values of ``mode`` that an ``EnergyTankTransform`` accepts.
TANK_LAWS: dict[str, TankLaw] = {"paper": energy_tank}
