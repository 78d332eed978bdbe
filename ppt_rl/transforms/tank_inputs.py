"""What an energy tank reads besides effort, velocity and level: limits per step, damping and inertia."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from typing import Any

import torch
from tensordict.utils import NestedKey, expand_as_right, unravel_key
from torch import Tensor

from ppt_rl.functional.argument_checks import shown
from ppt_rl.functional.checks import require_all, require_finite
from ppt_rl.functional.energy_tank import TANK_LAWS, EnergyTankStep, law_reads
from ppt_rl.functional.limits import EffortBounds, scale_into
from ppt_rl.functional.tank_laws import dissipative_part

__all__ = [
    "beside_key",
    "limit_within",
    "passing_part",
    "require_inertia",
    "require_keys",
    "require_law",
    "require_level",
    "require_read",
    "require_result",
]

#: What a law may read, and the argument of the transform that gives it.
_ARGUMENTS = {"damping": "damping_key", "inertia": "inertia"}
#: Largest difference between the level in the tensordict and the tank's own, as a share of the capacity [-].
_SAME_LEVEL = 1e-5
#: The laws of this library.
_LAWS = frozenset(TANK_LAWS.values())


def require_keys(out_keys: tuple[NestedKey, ...], p_max_key: NestedKey | None, e_max_key: NestedKey | None) -> None:
    """Raise unless a tank writes two entries and finds its limits per step, if any, in others.

    Args:
        out_keys: where level and valve are written.
        p_max_key: where the power limit is found.
        e_max_key: where the capacity is found.

    Raises:
        ValueError: if keys are missing or equal.
    """
    if len(out_keys) != 2 or out_keys[0] == out_keys[1]:
        raise ValueError(f"out_keys are {out_keys}; expected two: where the level and the valve are written.")
    limits = [unravel_key(key) for key in (p_max_key, e_max_key) if key is not None]
    if len({*limits, *map(unravel_key, out_keys)}) < len(limits) + 2:
        raise ValueError(
            f"p_max_key is {p_max_key!r} and e_max_key {e_max_key!r}; expected keys that differ from each other and "
            f"from out_keys {out_keys}."
        )


def beside_key(energy_key: NestedKey, what: str) -> NestedKey:
    """Where a tank keeps a further state: beside its level.

    Args:
        energy_key: where the level is written.
        what: name of the state.

    Returns:
        The same key with an underscore and that name appended to its last part.
    """
    *nest, name = energy_key if isinstance(energy_key, tuple) else (energy_key,)
    return unravel_key((*nest, f"{name}_{what}"))


def require_read(mode: str, law: Callable[..., Any], damping_key: NestedKey | None, inertia: Any) -> None:
    """Raise unless a law gets what it needs, and nothing that it does not read.

    Args:
        mode: its name.
        law: the law; what has a default in its signature may be missing.
        damping_key: where the damping is found, None for nowhere.
        inertia: the inertia, None for none.

    Raises:
        ValueError: if something is missing or superfluous.
    """
    given = {"damping": damping_key is not None, "inertia": inertia is not None}
    needed = law_reads(law, needed=True)
    for name, is_given in given.items():
        is_read, argument = name in law_reads(law), _ARGUMENTS[name]
        if name in needed and not is_given:
            advice = {
                "damping": "the key under which an ImpedanceTransform(damping_key=...) writes the damping",
                "inertia": "the inertia that the effort accelerates, such as the arm's Kinematics for joint torque",
            }
            raise ValueError(f"{argument} is None; expected {advice[name]}, which the law mode={mode!r} reads.")
        if is_given and not is_read:
            raise ValueError(f"{argument} is given, but mode={mode!r} reads no {name}; expected None. Leave it out.")


def require_law(mode: str, law: Callable[..., Any]) -> None:
    """Raise unless a law can be called as the transform calls it.

    Args:
        mode: its name.
        law: the law.

    Raises:
        ValueError: if it lacks an argument of that form, or has others that are not known.
    """
    usual = {"p_max": 0.0, "e_max": 0.0, "dt": 0.0, "eps": 0.0}
    try:
        inspect.signature(law).bind(0.0, 0.0, 0.0, **usual, **dict.fromkeys(law_reads(law), 0.0))
    except TypeError as error:
        raise ValueError(
            f"the law mode={mode!r} cannot be called as law(effort, flow, energy, *, p_max, e_max, dt, eps): {error}; "
            "expected that form, with damping, inertia and stored as the only further arguments."
        ) from error


def require_result(mode: str, law: Callable[..., Any], step: Any, energy: Tensor, e_max: float) -> EnergyTankStep:
    """Raise unless a law returned what it should; the laws of this library are not checked, since they are proven.

    Args:
        mode: its name.
        law: the law.
        step: what it returned.
        energy: ``(*B, 1)`` level before the step [J].
        e_max: capacity [J].

    Returns:
        The result.

    Raises:
        ValueError: if it is no ``EnergyTankStep``, or a part of it has another shape than the level or is out of range.
    """
    if law in _LAWS:
        return step
    if not isinstance(step, EnergyTankStep):
        raise ValueError(
            f"the law mode={mode!r} returned {type(step).__name__}; expected an EnergyTankStep(valve, energy, power)."
        )
    for name, value in step._asdict().items():
        if value.shape != energy.shape:
            raise ValueError(
                f"the law mode={mode!r} returned {name} of shape {tuple(value.shape)}; expected {tuple(energy.shape)}, "
                "one number for each environment."
            )
    valve, level = step.valve, step.energy
    require_all((valve >= 0) & (valve <= 1), f"the law mode={mode!r} returned a valve outside of [0, 1].")
    allowed = (level >= 0) & (level <= e_max * (1 + _SAME_LEVEL))
    require_all(allowed, f"the law mode={mode!r} returned a level outside of [0, {e_max}] J, the capacity.")
    return step


def require_inertia(inertia: Sequence[float] | Tensor) -> Tensor:
    """An inertia by axis ``(N,)`` or as a symmetric, positive definite matrix ``(N, N)``.

    Args:
        inertia: numbers.

    Returns:
        The same as a tensor.

    Raises:
        ValueError: if it is neither.
    """
    expected = "expected positive numbers, one for each axis of the effort, or a positive definite matrix"
    try:
        value = torch.as_tensor(inertia, dtype=torch.get_default_dtype()).detach().clone()
    except (TypeError, ValueError, RuntimeError) as error:
        raise ValueError(f"inertia is {shown(inertia)}; {expected}.") from error
    by_axis = value.ndim == 1 and value.numel() > 0
    is_matrix = value.ndim == 2 and value.shape[0] == value.shape[1] > 0
    if not (by_axis or is_matrix) or not bool(value.isfinite().all()):
        raise ValueError(f"inertia is {shown(inertia)}; {expected}.")
    least = value if by_axis else torch.linalg.eigvalsh(value.double())
    if not bool((least > 0).all()) or (is_matrix and not torch.allclose(value, value.mT)):
        raise ValueError(f"inertia is {shown(inertia)}; {expected}.")
    return value


def require_level(
    key: NestedKey, given: Tensor, own: Tensor | None, e_max: float, shape: tuple[int, ...], rows: Tensor | None
) -> None:
    """Raise unless a level that was given for a step is one that the tank may have.

    Args:
        key: where it was found, for the message.
        given: the level [J].
        own: ``(*B, 1)`` the level that the tank remembers, of which the given one may fall short; None for none.
        e_max: capacity [J].
        shape: that the level must have.
        rows: ``(*B,)`` the environments that step; None stands for all of them.

    Raises:
        ValueError: if it has another shape, is not finite or negative, or is above the tank's own.
    """
    if given.shape != shape:
        raise ValueError(f"the level {key!r} has shape {tuple(given.shape)}; expected {shape}.")
    require_finite(str(key), given)
    require_all(given >= 0, f"the level {key!r} is negative; expected 0 to {e_max} J.")
    lawful = given <= (e_max if own is None else own) + _SAME_LEVEL * e_max
    require_all(
        lawful if rows is None else lawful | ~expand_as_right(rows, lawful),
        f"the level {key!r} in the tensordict is above the tank's own, which is at most e_max={e_max} J; expected the "
        "one that reset or the last step returned. Step from that one.",
    )


def limit_within(key: NestedKey, value: Tensor, most: float, like: Tensor) -> Tensor:
    """A limit that was given for a step, clamped to what is allowed.

    Args:
        key: where it was found, for the message.
        value: ``(*B, 1)`` the limit.
        most: its hard bound.
        like: ``(*B, N)`` effort.

    Returns:
        ``(*B, 1)`` in [0, most].

    Raises:
        ValueError: if it has another shape or is NaN.
    """
    if value.shape != (*like.shape[:-1], 1):
        raise ValueError(
            f"the limit {key!r} has shape {tuple(value.shape)}; expected {(*like.shape[:-1], 1)}, one number for each "
            "environment, that of its whole effort."
        )
    require_all(~value.isnan(), f"the limit {key!r} is NaN; expected numbers from 0 to {most}. Look at what writes it.")
    return value.to(like.dtype).clamp(0.0, most)


def passing_part(
    key: NestedKey,
    damping: Tensor,
    effort: Tensor,
    flow: Tensor,
    bounds: EffortBounds | None,
    factor: Tensor | None,
    *,
    inertia: Tensor | None,
    dt: float,
) -> Tensor:
    """The part of an effort that passes beside the valve: its damping within the bounds, where it surely brakes.

    Args:
        key: where the damping was found, for the message.
        damping: ``(*B, N)`` as it was written.
        effort: ``(*B, N)`` effort that it is part of.
        flow: ``(*B, N)`` the velocity that they work on.
        bounds: of the effort.
        factor: ``(*B, 1)`` by which the bounds have scaled the effort; None for not at all.
        inertia: what the effort accelerates, where the damping has to brake for the whole control step.
        dt: control step [s].

    Returns:
        ``(*B, N)``, zero where the damping does not brake.

    Raises:
        ValueError: if the damping has another shape than the effort, or is not finite.
    """
    if damping.shape != effort.shape:
        raise ValueError(
            f"the damping {key!r} has shape {tuple(damping.shape)}, the effort {tuple(effort.shape)}; expected the "
            "same. A JointTorqueTransform between them carries it to joint space: pass it the same damping_key."
        )
    damping = damping if factor is None else damping * factor
    damping = damping if bounds is None else scale_into(damping, bounds)[0]
    return dissipative_part(damping, flow, inertia=inertia, dt=dt)
