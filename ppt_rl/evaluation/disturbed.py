"""A policy that acts in a scenario of the collision benchmark."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from torch import nn
from torchrl.envs import Transform

from ppt_rl.envs import ArmEnv
from ppt_rl.evaluation.policy import Policy
from ppt_rl.evaluation.scenario import Scenario
from ppt_rl.evaluation.spring_energy import SpringEnergyTransform
from ppt_rl.modules.impedance import CartesianImpedanceController
from ppt_rl.transforms import CartesianVelocityTransform

__all__ = ["beside_the_reference", "in_scenario"]


def in_scenario(policy: Policy, scenario: Scenario) -> Policy:
    """The same policy, which acts in a scenario.

    Args:
        policy: any policy of the task.
        scenario: what goes wrong.

    Returns:
        The policy; its environment also writes ``spring_energy``.

    Raises:
        ValueError: if its chain has no impedance controller.
    """
    recipe = policy.recipe

    def make_chain(config: Any, base: ArmEnv, **modules: nn.Module) -> list[Transform]:
        return scenario.chain(_with_spring_energy(recipe.make_chain(config, base, **modules), recipe.variant))

    changed = policy.with_changes(**scenario.options(policy.config))
    task = replace(recipe.task, make_test_env=scenario.make_env)
    return replace(changed, recipe=replace(recipe, task=task, make_chain=make_chain))


def _with_spring_energy(chain: list[Transform], variant: str) -> list[Transform]:
    """The chain with a record of the energy in the spring right outside the impedance."""
    for place, transform in enumerate(chain, start=1):
        controller = getattr(transform, "controller", None)
        if isinstance(controller, CartesianImpedanceController):
            return [*chain[:place], SpringEnergyTransform(controller), *chain[place:]]
    raise ValueError(f"the chain of {variant} has no impedance controller; expected an ImpedanceTransform in it.")


def beside_the_reference(chain: list[Transform], transform: Transform) -> list[Transform]:
    """Insert a transform of the reference outside every layer that acts on it at control rate.

    So a layer that guards the reference sees what the transform does to it, as it sees what the policy does.

    Args:
        chain: transforms from the environment outwards.
        transform: acts on the reference.

    Returns:
        The new chain: the transform stands right inside of the one that makes the reference from the policy's action.
    """
    makers = (place for place, part in enumerate(chain) if _makes_reference(part))
    place = next(makers, len(chain))
    return [*chain[:place], transform, *chain[place:]]


def _makes_reference(transform: Transform) -> bool:
    return isinstance(transform, CartesianVelocityTransform) or bool(getattr(transform, "macro_step", False))
