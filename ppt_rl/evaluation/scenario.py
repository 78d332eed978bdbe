"""A scenario of the collision benchmark: what goes wrong in otherwise ordinary episodes of a task."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from torch import nn
from torchrl.envs import Transform

from ppt_rl.envs import ArmEnv
from ppt_rl.evaluation.policy import Policy
from ppt_rl.evaluation.spring_energy import SpringEnergyTransform
from ppt_rl.evaluation.task import MakeEnv
from ppt_rl.modules.impedance import CartesianImpedanceController
from ppt_rl.transforms import CartesianVelocityTransform

__all__ = ["Scenario", "beside_the_reference"]

#: From a chain (from the environment outwards) to the chain with something inserted.
ChangeChain = Callable[[list[Transform]], list[Transform]]


def _no_options(config: Any) -> dict[str, Any]:
    return {}


def _no_change(chain: list[Transform]) -> list[Transform]:
    return chain


@dataclass(frozen=True)
class Scenario:
    """What goes wrong, and what is changed for it: environment, options or chain.

    Attributes:
        name: its name on the command line.
        summary: what happens, in a few words, for tables.
        make_env: makes the environment of the test with what is in the way; it writes the quantities of
            :data:`ppt_rl.envs.contact_audit.CONTACT`.
        options: from the options of a recipe, those to change.
        chain: inserts what disturbs sensors or reference.
        kinds: names of the kinds of episodes, where there are several: the environment writes the number as ``kind``.
    """

    name: str
    summary: str
    make_env: MakeEnv
    options: Callable[[Any], Mapping[str, Any]] = _no_options
    chain: ChangeChain = _no_change
    kinds: tuple[str, ...] = ()

    def applied_to(self, policy: Policy) -> Policy:
        """The same policy, which acts in this scenario.

        Args:
            policy: any policy of the task.

        Returns:
            The policy; its environment also writes ``spring_energy``.

        Raises:
            ValueError: if its chain has no impedance controller.
        """
        recipe = policy.recipe

        def make_chain(config: Any, base: ArmEnv, **modules: nn.Module) -> list[Transform]:
            return self.chain(_with_spring_energy(recipe.make_chain(config, base, **modules), recipe.variant))

        changed = policy.with_changes(**self.options(policy.config))
        task = replace(recipe.task, make_test_env=self.make_env)
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
