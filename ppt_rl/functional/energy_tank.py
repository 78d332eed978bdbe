"""The energy tank: a power and energy budget that scales an effort."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import threshold

from ppt_rl.functional.checks import require_finite

__all__ = ["EnergyTankStep", "energy_tank"]


class EnergyTankStep(NamedTuple):
    """What one control step of the tank decides.

    Attributes:
        valve: ``(*B, 1)`` factor in [0, 1] on the effort (gamma in the paper).
        energy: ``(*B, 1)`` tank level after the step [J].
        power: ``(*B, 1)`` scaled power ``valve * p`` [W], never above ``p_max``.
    """

    valve: Tensor
    energy: Tensor
    power: Tensor


def energy_tank(
    effort: Tensor, flow: Tensor, energy: Tensor, *, p_max: float, e_max: float, dt: float, eps: float = 1e-6
) -> EnergyTankStep:
    r"""Valve and next level of a tank that meters ``p = |effort . flow|``.

    .. math::
        \gamma &= \min\Big(1,\ \frac{P_{max}}{\max(\epsilon, p)},\ \frac{E}{\Delta t \max(\epsilon, p)}\Big) \\
        E' &= \mathrm{clip}(E - \gamma\, p\, \Delta t,\ 0,\ E_{max})

    Both roundings go to the safe side by four units in the last place: ``valve * p <= p_max`` and
    ``sum(valve * p * dt) <= E_0`` hold for the stored floating-point numbers, not only on paper. Where numbers are
    subnormal, ulps mean nothing, so such a valve is closed and a level of next to nothing counts as empty.

    Args:
        effort: ``(*B, N)`` nominal effort: wrench [N, N m] or joint torque [N m].
        flow: ``(*B, N)`` the velocity it works on: twist [m/s, rad/s] or joint velocity [rad/s].
        energy: ``(*B, 1)`` tank level [J].
        p_max: power limit [W].
        e_max: tank capacity [J].
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
