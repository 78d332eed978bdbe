"""The recipes by variant, and how a trained policy is brought back with its chain."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, NamedTuple

from torch import nn
from torchrl.envs import ExcludeTransform, TransformedEnv

from ppt_rl.envs import MazeLayout, MazeRanges
from ppt_rl.evaluation import is_pretrained, load_pretrained, pretrained_card
from ppt_rl.tasks.maze import MAZE_PRIVILEGED
from ppt_rl.tasks.push import PRIVILEGED
from ppt_rl.training import CheckpointMismatch, PPOConfig, checkpoint_info, find_checkpoint, load_checkpoint

#: Variants and the recipes that build their chains, in the order of the paper's tables.
RECIPES = {
    "pp_push": "ppo_pp_push",
    "ppt_push": "ppo_ppt_push",
    "s_push": "ppo_s_push",
    "st_push": "ppo_st_push",
    "ppt_maze": "ppo_ppt_maze",
    "st_maze": "ppo_st_maze",
}


class Policy(NamedTuple):
    """A trained policy and what it runs in.

    Attributes:
        variant: name of the recipe's variant.
        recipe: its module.
        config: its options.
        modules: what the chain needs besides the options, such as the movement primitive.
        actor: the policy.
    """

    variant: str
    recipe: Any
    config: Any
    modules: dict[str, nn.Module]
    actor: nn.Module

    def with_changes(self, changes: Mapping[str, Any]) -> Policy:
        """The same policy with some options changed.

        Args:
            changes: options by name.

        Returns:
            The policy.
        """
        return self._replace(config=replace(self.config, **changes))

    @property
    def task(self) -> str:
        """Name of the task: ``push`` or ``maze``."""
        return self.variant.rsplit("_", 1)[-1]

    def make_env(
        self,
        *,
        num_envs: int,
        seed: int,
        audit: bool = False,
        privileged: bool = False,
        layouts: Sequence[MazeLayout] = (),
        ranges: MazeRanges | None = None,
        **changes: Any,
    ) -> TransformedEnv:
        """The recipe's chain on the task of the test.

        Args:
            num_envs: environments that step together.
            seed: of the episodes.
            audit: whether power and work are measured at the physics' rate too.
            privileged: whether privileged observations stay, for pictures; the policy reads none.
            layouts: mazes to take in turn, for a maze policy.
            ranges: of random mazes where there are no layouts; None takes those of the test.
            **changes: options to change.

        Returns:
            The environment.
        """
        config = replace(self.config, **changes)
        test: dict[str, Any] = {}
        if self.task == "maze":
            test = {"layouts": layouts, "ranges": MazeRanges() if ranges is None else ranges}
        env = self.recipe.make_env(config, *self.modules.values(), num_envs=num_envs, seed=seed, audit=audit, **test)
        hidden = MAZE_PRIVILEGED if self.task == "maze" else PRIVILEGED
        return env if privileged else env.append_transform(ExcludeTransform(*hidden))


def recipe_of(variant: str) -> Any:
    """The recipe module of a variant.

    Args:
        variant: its name.

    Returns:
        The module.

    Raises:
        CheckpointMismatch: if there is none of that name.
    """
    if variant not in RECIPES:
        raise CheckpointMismatch(f"variant {variant!r} is unknown; expected one of {sorted(RECIPES)}.")
    return importlib.import_module(RECIPES[variant])


def restored_config(recipe: Any, settings: Mapping[str, Any], source: Path) -> Any:
    """A recipe's options from their JSON form.

    Args:
        recipe: its module.
        settings: options by name.
        source: where they come from, for messages.

    Returns:
        The recipe's ``Config``.

    Raises:
        CheckpointMismatch: if an option is unknown, missing or impossible.
    """
    settings = {key: value for key, value in settings.items() if key != "variant"}
    known = {field.name for field in fields(recipe.Config)}
    if set(settings) != known:
        differing = ", ".join(sorted(set(settings) ^ known))
        raise CheckpointMismatch(f"{source} was written by another version of {recipe.VARIANT}: options {differing}.")
    try:
        settings["ppo"] = PPOConfig(**settings["ppo"])
        if "box_sizes" in settings:
            settings["box_sizes"] = tuple(settings["box_sizes"])
        settings["run_dir"] = Path(settings["run_dir"])
        return recipe.Config(**settings)
    except (TypeError, ValueError) as error:
        raise CheckpointMismatch(f"{source} holds options that do not fit {recipe.VARIANT} ({error}).") from error


def load_policy(path: Path) -> Policy:
    """Bring back a policy.

    Args:
        path: a published policy, a checkpoint, or the directory of a run for its newest one.

    Returns:
        The policy.

    Raises:
        CheckpointMismatch: if it is unreadable, was changed, or is of something else.
    """
    published = is_pretrained(path)
    path = path if published else find_checkpoint(path)
    info = pretrained_card(path) if published else checkpoint_info(path)
    recipe = recipe_of(info["variant"])
    config = restored_config(recipe, info["config"], path)
    modules = recipe.make_modules(config)
    actor, _ = recipe.make_policy(config, recipe.make_env(config, *modules.values(), num_envs=1))
    (load_pretrained if published else load_checkpoint)(path, {"actor": actor, **modules})
    return Policy(info["variant"], recipe, config, modules, actor)
