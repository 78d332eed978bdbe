"""The invariants of the laws of the tank, checked in exact fractions of the stored numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ppt_rl.functional import EnergyTankStep, energy_tank, impact_tank, parallel_tank, passive_tank, rate_tank
from ppt_rl.functional.tank_laws import beside, dissipative_part


class LawCase(NamedTuple):
    """A law and what it reads besides the usual: from damping and inertia, its further arguments."""

    law: Callable[..., EnergyTankStep]
    read: Callable[[Tensor, Tensor], dict[str, Any]]


LAW_CASES = {
    "paper": LawCase(energy_tank, lambda damping, inertia: {}),
    "passive": LawCase(passive_tank, lambda damping, inertia: {}),
    "parallel": LawCase(parallel_tank, lambda damping, inertia: {"damping": damping}),
    "passive ahead": LawCase(passive_tank, lambda damping, inertia: {"inertia": inertia}),
    "parallel ahead": LawCase(parallel_tank, lambda damping, inertia: {"damping": damping, "inertia": inertia}),
    "rate": LawCase(rate_tank, lambda damping, inertia: {"inertia": inertia}),
    "impact": LawCase(impact_tank, lambda damping, inertia: {"inertia": inertia}),
}


def exact(value: Tensor | float) -> Fraction:
    """The number that is stored."""
    return Fraction(value.item() if isinstance(value, Tensor) else value)


def fractions(values: Tensor) -> list[Fraction]:
    """The numbers that are stored."""
    return [Fraction(value) for value in values.flatten().tolist()]


def dot(a: Sequence[Fraction], b: Sequence[Fraction]) -> Fraction:
    """Exact scalar product."""
    return sum((x * y for x, y in zip(a, b, strict=True)), Fraction(0))


def check_step(
    name: str, effort: Tensor, flow: Tensor, damping: Tensor, energy: Tensor, inertia: Tensor, *, p_max, e_max, dt
) -> tuple[Tensor, Fraction]:
    """One control step of a law: assert what its docstring states, and return the level and the energy delivered [J].

    What is delivered is the net energy; for laws that look ahead it is the integral of the worst power over the step.
    """
    case = LAW_CASES[name]
    out = case.law(effort, flow, energy, p_max=p_max, e_max=e_max, dt=dt, **case.read(damping, inertia))
    return check_result(name, out, effort, flow, damping, energy, inertia, p_max=p_max, e_max=e_max, dt=dt)


def check_result(
    name: str,
    out: EnergyTankStep,
    effort: Tensor,
    flow: Tensor,
    damping: Tensor,
    energy: Tensor,
    inertia: Tensor,
    *,
    p_max,
    e_max,
    dt,
) -> tuple[Tensor, Fraction]:
    """The same for a result of the law that is at hand already."""
    passed, looked = torch.zeros_like(effort), {"inertia": inertia, "dt": dt} if name == "parallel ahead" else {}
    if name in ("parallel", "parallel ahead"):
        passed = dissipative_part(damping, flow, **looked)
    executed = beside(out.valve, effort, passed)
    limit, step = max(exact(p_max), Fraction(0)), Fraction(dt)
    power = dot(fractions(executed), fractions(flow))
    paid = exact(energy) - exact(out.energy)

    assert 0 <= exact(out.valve) <= 1
    assert 0 <= exact(out.energy) <= max(exact(e_max), Fraction(0)) * (1 + Fraction(1, 10**7))  # as a rounded number
    assert power <= limit
    if name == "paper":
        power = abs(power)
        assert power <= limit
    delivered = power * step
    if name == "passive":
        terms = [x * y for x, y in zip(fractions(effort), fractions(flow), strict=True)]
        doubt = 20 * Fraction(torch.finfo(effort.dtype).eps) * sum(map(abs, terms))
        assert sum(terms) >= -doubt or out.valve == 1  # what surely brakes passes
    if name in ("parallel", "parallel ahead"):
        assert dot(fractions(passed), fractions(flow)) <= 0
        active = exact(out.valve) * abs(dot(fractions(effort - passed), fractions(flow)))
        assert active <= limit
        assert active * step <= paid
    if name in ("passive ahead", "parallel ahead"):
        held, masses = fractions(executed), fractions(inertia)
        rise = dot(held, [x / m for x, m in zip(held, masses, strict=True)])
        assert power + step * rise <= limit
        delivered = step * (power + step * rise / 2)
    if name in ("rate", "impact"):
        held, masses = fractions(executed), fractions(inertia)
        rise = dot(held, [x / m for x, m in zip(held, masses, strict=True)])
        if name == "impact":  # sqrt(rise) sqrt(square) + step rise <= limit, without the roots
            square = dot(fractions(flow), [v * m for v, m in zip(fractions(flow), masses, strict=True)])
            assert step * rise <= limit
            assert rise * square <= (limit - step * rise) ** 2
        assert abs(power) + step * rise <= limit
        delivered = step * (abs(power) + step * rise / 2)
    assert delivered <= paid
    return out.energy, delivered
