"""What of a policy's world can be changed while one looks at it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from ppt_rl.evaluation import Policy

__all__ = ["Setting", "changed_policy", "settings_of"]


@dataclass(frozen=True)
class Setting:
    """A number that a slider changes.

    Attributes:
        name: name of the option; ``friction`` stands for the range of the randomisation.
        label: what the slider is called, with its unit.
        low: smallest value.
        high: largest value.
        value: value at the start.
    """

    name: str
    label: str
    low: float
    high: float
    value: float


def settings_of(policy: Policy) -> list[Setting]:
    """The settings that a policy has: those of its tank, the stiffness, and the friction of what it pushes.

    Args:
        policy: the policy.

    Returns:
        The settings, those that it lacks left out.
    """
    config = policy.config
    found = []
    if policy.recipe.has_tank:
        found.append(Setting("p_max", "power limit [W]", 0.2, max(6.0, config.p_max), config.p_max))
        found.append(Setting("e_max", "tank capacity [J]", 0.1, max(4.0, config.e_max), config.e_max))
    found.append(Setting("stiffness", "stiffness [N/m]", 50.0, max(1500.0, config.stiffness), config.stiffness))
    friction = getattr(getattr(config, "randomisation", None), "friction", None)
    if friction is not None:
        found.append(Setting("friction", "box friction [-]", 0.05, 1.0, 0.5 * sum(friction)))
    return found


def changed_policy(policy: Policy, values: Mapping[str, float]) -> Policy:
    """The same policy in a world with other settings.

    Args:
        policy: the policy.
        values: new values by name of the setting.

    Returns:
        The policy.

    Raises:
        ValueError: if the policy has no such setting, or a value is impossible.
    """
    known = [setting.name for setting in settings_of(policy)]
    unknown = sorted(set(values) - set(known))
    if unknown:
        raise ValueError(f"setting {unknown[0]!r} is unknown; expected one of {known}.")
    changes: dict[str, Any] = dict(values)
    if "friction" in changes:
        friction = changes.pop("friction")
        changes["randomisation"] = replace(policy.config.randomisation, friction=(friction, friction))
    return policy.with_changes(**changes) if changes else policy
