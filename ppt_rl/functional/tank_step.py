"""What the laws of the tank share: their form, the power of an effort with its rounding error, and paying for it."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor

from ppt_rl.functional.checks import are_finite, require_finite
from ppt_rl.functional.constants import constant

__all__ = [
    "EnergyTankStep",
    "TankLaw",
    "as_level",
    "budgets",
    "coarsest",
    "settled",
    "upper_power",
    "valve_for",
    "within",
]


class EnergyTankStep(NamedTuple):
    """The result of one control step of a tank.

    Attributes:
        valve: ``(*B, 1)`` factor on the effort in [0, 1] (gamma in the paper).
        energy: ``(*B, 1)`` level of the tank after the step [J].
        power: ``(*B, 1)`` power of the scaled effort, rounding included: what the tank pays for [W]. A law that refills
            the tank has negative ones.
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

    From then on ``EnergyTankTransform(mode="shut")`` runs it. The arguments are those of
    :func:`~ppt_rl.functional.energy_tank.energy_tank`. The limits ``p_max`` and ``e_max`` are numbers, or tensors
    ``(*B, 1)`` where they are given per step. A law says by its signature what else it reads: with a keyword argument
    ``damping`` it gets the dissipative part of the effort, which passes whole, with ``inertia`` the inertia that the
    effort accelerates, and with ``stored`` the energy that contact may hold, in the same inertia
    (:func:`~ppt_rl.functional.tank_ahead.recent_motion`). What has a default there may be left out of the transform.
    """

    def __call__(self, effort: Tensor, flow: Tensor, energy: Tensor, *args: Any, **kwargs: Any) -> EnergyTankStep:
        """Execute one control step."""
        ...


@cache
def coarsest(*dtypes: torch.dtype) -> float:
    """Distance from 1 to the next number in the coarsest of some formats.

    Args:
        *dtypes: the formats.

    Returns:
        The distance.
    """
    return max(torch.finfo(dtype).eps for dtype in dtypes)


def upper_power(
    effort: Tensor, flow: Tensor, energy: Tensor, ulp: float, *, signed: bool = False, roundings: int = 3
) -> tuple[Tensor, Tensor | None]:
    r"""An upper bound of the power of stored numbers, however much of it cancels.

    .. math:: p = |\mathrm{effort} \cdot \mathrm{flow}|
        + \tfrac12 (N + r)\,u\,\textstyle\sum_i |\mathrm{effort}_i\,\mathrm{flow}_i|

    Products too small for the format count as zero.

    Args:
        effort: ``(*B, N)``.
        flow: ``(*B, N)``.
        energy: ``(*B, 1)`` level, which has to be finite too.
        ulp: u, of the coarsest of them.
        signed: whether the power keeps its sign: then the bound is that of ``effort . flow`` itself.
        roundings: r, how often an effort and the sum are rounded besides the N operations of the sum.

    Returns:
        The bound ``(*B, 1)`` [W], zero where it is too large for the format, and where it fits; None stands for
        everywhere.

    Raises:
        ValueError: if a shape does not fit or an input is not finite.
    """
    if effort.shape[-1:] != flow.shape[-1:] or energy.shape[-1:] != (1,):
        raise ValueError(
            f"effort is {tuple(effort.shape)}, flow {tuple(flow.shape)}, tank_energy {tuple(energy.shape)} in shape; "
            "expected effort and flow (*B, N) and a level (*B, 1)."
        )
    terms = effort * flow
    share = 0.5 * (terms.shape[-1] + roundings) * ulp
    total = terms.sum(-1, keepdim=True)
    p = torch.add(total if signed else total.abs(), terms.abs().sum(-1, keepdim=True), alpha=share)
    if are_finite(p + energy):  # then so are effort, flow and level
        return p, None
    for name, value in (("effort", effort), ("flow", flow), ("tank_energy", energy)):
        require_finite(name, value)
    fits = p.isfinite()
    return torch.where(fits, p, 0.0), fits


def valve_for(
    p: Tensor,
    fits: Tensor | None,
    energy: Tensor,
    *,
    p_max: float | Tensor,
    dt: float,
    eps: float,
    ulp: float,
) -> Tensor:
    """The valve that lets at most a limit and a level through, rounded down: that of the paper's law.

    Args:
        p: ``(*B, 1)`` upper bound of the power [W].
        fits: ``(*B, 1)`` where it fits the format; None stands for everywhere.
        energy: ``(*B, 1)`` level [J].
        p_max: power limit [W].
        dt: control step [s].
        eps: smallest power that is divided by [W].
        ulp: distance from 1 to the next number of the coarsest input.

    Returns:
        ``(*B, 1)`` in [0, 1]; zero where it would be subnormal, or the level is.
    """
    tiny, ulps = torch.finfo(energy.dtype).tiny, 4 * ulp
    usable = torch.threshold(energy, tiny / ulps, 0.0)  # [J]
    limit = (usable / constant(dt, usable)).clamp_max(p_max) / p.clamp_min(eps)
    limit = limit if fits is None else limit * fits
    return torch.threshold((limit * constant(1 - ulps, limit)).clamp_max(1.0), tiny, 0.0)


def settled(
    valve: Tensor, power: Tensor, is_paid: Tensor, energy: Tensor, *, e_max: float | Tensor, dt: float, ulp: float
) -> EnergyTankStep:
    """Pay for what passes, rounded up.

    Args:
        valve: ``(*B, 1)`` [-].
        power: ``(*B, 1)`` to pay for, at least zero [W].
        is_paid: ``(*B, 1)`` where anything is paid.
        energy: ``(*B, 1)`` level before the step [J].
        e_max: capacity [J].
        dt: control step [s].
        ulp: distance from 1 to the next number of the coarsest input.

    Returns:
        The result, in the precision of the level.
    """
    ulps = 4 * ulp
    rounded = torch.where(is_paid, energy * constant(1 - ulps, energy), energy)  # [J]
    level = rounded - power * constant(dt * (1 + ulps), power)  # [J]
    return as_level(EnergyTankStep(valve, within(level, e_max), power), energy)


def as_level(step: EnergyTankStep, energy: Tensor) -> EnergyTankStep:
    """A result in the precision of the level.

    Args:
        step: the result.
        energy: the level.

    Returns:
        The same numbers.
    """
    return step if step.power.dtype == energy.dtype else EnergyTankStep(*(value.to(energy.dtype) for value in step))


def within(level: Tensor, e_max: float | Tensor) -> Tensor:
    """A level between zero and the capacity.

    Args:
        level: ``(*B, 1)`` [J].
        e_max: capacity [J].

    Returns:
        ``(*B, 1)`` [J].
    """
    return level.clamp_max(e_max).clamp_min(0.0) if isinstance(e_max, Tensor) else level.clamp(0.0, e_max)


def budgets(
    energy: Tensor, p_max: float | Tensor, e_max: float | Tensor
) -> tuple[Tensor, float | Tensor, float | Tensor]:
    """Limits that may be given per step; a negative one counts as zero.

    Args:
        energy: ``(*B, 1)`` level [J].
        p_max: power limit [W].
        e_max: capacity [J].

    Returns:
        Level, power limit and capacity; a capacity below the level has clipped it.

    Raises:
        ValueError: if a limit is a tensor that is not finite or does not have the shape of the level.
    """
    if not isinstance(p_max, Tensor) and not isinstance(e_max, Tensor):
        return energy, p_max, e_max
    p_max, e_max = _limit("p_max", p_max, energy), _limit("e_max", e_max, energy)
    return energy if not isinstance(e_max, Tensor) else torch.minimum(energy, e_max), p_max, e_max


def _limit(name: str, value: float | Tensor, energy: Tensor) -> float | Tensor:
    if not isinstance(value, Tensor):
        return value
    if value.shape != energy.shape:
        raise ValueError(
            f"{name} has shape {tuple(value.shape)}; expected a number, or one for each level: {tuple(energy.shape)}."
        )
    require_finite(name, value)
    return value.to(energy.dtype).clamp_min(0.0)
