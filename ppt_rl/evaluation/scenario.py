"""A scenario of the collision benchmark: what goes wrong in otherwise ordinary episodes of a task."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from torchrl.envs import Transform

from ppt_rl.evaluation.make_env import MakeEnv

__all__ = ["Scenario"]

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
