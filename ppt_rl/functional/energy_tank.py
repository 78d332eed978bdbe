"""The energy tank: a budget of power and energy that scales an effort, and the registry of its laws."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import torch
from torch import Tensor
from torch.nn.functional import threshold

from ppt_rl.functional.checks import require_finite

__all__ = ["TANK_LAWS", "EnergyTankStep", "TankLaw", "energy_tank"]


class EnergyTankStep(NamedTuple):
    """The result of one control step of a tank.

    Attributes:
        valve: ``(*B, 1)`` factor on the effort in [0, 1] (gamma in the paper).
        energy: ``(*B, 1)`` level of the tank after the step [J].
        power: ``(*B, 1)`` power of the scaled effort, ``valve * p`` [W].
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

    Valve and level are both rounded to the safe side by four units in the last place, so that ``valve * p <= p_max``
    and ``sum(valve * p * dt) <= E_0`` hold for the stored floating-point numbers, not only on paper. Subnormal numbers
    have too few digits for that: a valve that small is closed, and a level that small counts as empty.

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
        ValueError: if the power or the level is not finite.

    Source:
        Paper, eq. (10) (problem definition) and section "Energy-Tank Layer for Safe Execution".
    """
    p = (effort * flow).sum(-1, keepdim=True).abs()  # [W]
    require_finite("power of the energy tank (effort . flow)", p)
    require_finite("tank_energy", energy)
    ulps = 4 * torch.finfo(p.dtype).eps
    divisor = p.clamp_min(eps)
    tiny = torch.finfo(p.dtype).tiny
    usable = threshold(energy, tiny / ulps, 0.0)  # [J]
    limit = torch.minimum(usable / dt, torch.full_like(energy, p_max)) / divisor
    valve = threshold((limit * (1 - ulps)).clamp_max(1.0), tiny, 0.0)
    power = valve * p
    spent = power * dt  # [J]
    level = energy * (1 - ulps * (p > 0).to(p.dtype)) - spent * (1 + ulps)
    return EnergyTankStep(valve, level.clamp(0.0, e_max), power)


#: The laws of the tank by name: the values of ``mode`` that an ``EnergyTankTransform`` accepts.
TANK_LAWS: dict[str, TankLaw] = {"paper": energy_tank}
