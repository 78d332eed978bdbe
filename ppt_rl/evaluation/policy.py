"""Trained policies: published ones, checkpoints and runs, each with the chain it acts through."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from torch import nn
from torchrl.envs import EnvBase, ExcludeTransform, TransformedEnv

from ppt_rl.evaluation.episodes import ZeroPolicy
from ppt_rl.evaluation.published import is_pretrained, load_pretrained, pretrained_card, published_policies
from ppt_rl.evaluation.recipe import Recipe, find_recipe
from ppt_rl.evaluation.task import Baseline
from ppt_rl.functional.argument_checks import require_instance
from ppt_rl.training import CheckpointMismatch, checkpoint_info, find_checkpoint, from_json, load_checkpoint

__all__ = ["REFERENCE_ALONE", "Policy", "load_policy", "restored_config"]

#: The baseline of every variant that acts on residuals: the action zero.
REFERENCE_ALONE = "reference alone"


@dataclass(frozen=True)
class Policy:
    """A trained policy and what it acts through.

    Attributes:
        recipe: its variant.
        config: its options.
        modules: what the chain needs besides the options, such as the movement primitive.
        actor: the policy: reads observations of :meth:`make_env`, writes ``action``.
        source: where it was loaded from.

    Examples:
        >>> policy = load_policy("ppt_push")
        >>> env = policy.make_env(num_envs=2, seed=0)
        >>> env.rollout(1, policy.actor)["next", "success"].shape
        torch.Size([2, 1, 1])
    """

    recipe: Recipe
    config: Any
    modules: Mapping[str, nn.Module]
    actor: nn.Module
    source: Path

    @property
    def variant(self) -> str:
        """Name of the variant."""
        return self.recipe.variant

    def with_changes(self, **changes: Any) -> Policy:
        """The same policy with some options changed.

        Args:
            **changes: options by name.

        Returns:
            The policy.

        Raises:
            ValueError: if an option is unknown or impossible.
        """
        known = [option.name for option in fields(self.config)]
        unknown = [name for name in changes if name not in known]
        if unknown:
            raise ValueError(f"option {unknown[0]!r} is unknown; expected one of {sorted(known)}.")
        return replace(self, config=replace(self.config, **changes))

    def make_env(
        self, num_envs: int = 1, *, seed: int | None = None, audit: bool = False, privileged: bool = False,
        given: Sequence[Any] = (),
    ) -> TransformedEnv:  # fmt: skip
        """The environment of the test with the chain of the policy, which moves to the device of its options.

        Args:
            num_envs: number of environments that step together.
            seed: seed of the episodes; None draws one.
            audit: whether power and work are measured at the rate of the physics.
            privileged: whether privileged observations stay, for pictures; the policy reads none of them.
            given: episodes to run in turn, in the task's own form, instead of random ones.

        Returns:
            The environment.
        """
        env = self.recipe.make_env(self.config, self.modules, num_envs=num_envs, seed=seed, audit=audit, given=given)
        self.actor.to(env.device)
        return env if privileged else env.append_transform(ExcludeTransform(*self.recipe.task.privileged))

    def baselines(self) -> list[str]:
        """Names of those that can act in the place of the policy, for comparison."""
        return [*([REFERENCE_ALONE] if self.recipe.has_reference else []), *self._baselines()]

    def _baselines(self) -> Mapping[str, Baseline]:
        """Those of the task that this variant has."""
        task = self.recipe.task
        return {**(task.references if self.recipe.has_reference else {}), **task.baselines}

    def make_baseline(
        self, name: str, num_envs: int = 1, *, seed: int | None = None, audit: bool = False, given: Sequence[Any] = ()
    ) -> tuple[EnvBase, Any]:
        """A baseline and what it acts on, in the episodes that the policy gets from the same seed.

        Args:
            name: one of :meth:`baselines`.
            num_envs: number of environments that step together.
            seed: seed of the episodes; None draws one.
            audit: whether power and work are measured at the rate of the physics.
            given: episodes to run in turn, in the task's own form, instead of random ones.

        Returns:
            Environment and actor.

        Raises:
            ValueError: if there is none of that name.
        """
        if name not in self.baselines():
            raise ValueError(f"baseline {name!r} is unknown for {self.variant}; expected one of {self.baselines()}.")
        if name == REFERENCE_ALONE:
            return self.make_env(num_envs, seed=seed, audit=audit, given=given), ZeroPolicy(self.actor)
        task = self.recipe.task
        base = task.make_test_env(self.config, num_envs=num_envs, seed=seed, audit=audit, given=given)
        return self._baselines()[name](self, base)


def restored_config(recipe: Recipe, settings: Mapping[str, Any], source: Path) -> Any:
    """A recipe's options from their JSON form.

    Args:
        recipe: the recipe.
        settings: options by name.
        source: where they come from, for messages.

    Returns:
        The options.

    Raises:
        CheckpointMismatch: if an option is unknown, missing or impossible.
    """
    try:
        return from_json(recipe.config, {k: v for k, v in settings.items() if k not in ("variant", "recipe")})
    except ValueError as error:
        raise CheckpointMismatch(f"{source} was written by another version of {recipe.variant}: {error}") from error


def load_policy(source: str | Path, *, recipe: str | Path | None = None) -> Policy:
    """Load a policy with the chain it acts through.

    Args:
        source: name of a published policy, or path of a checkpoint, of a run (its newest checkpoint is taken) or of a
            directory with a card.
        recipe: variant or file of the recipe; None takes the one that trained the policy.

    Returns:
        The policy.

    Raises:
        CheckpointMismatch: if it is unreadable, was changed, or does not fit the recipe.
        ValueError: if ``source`` is neither a name nor a path.
    """
    require_instance("source", source, str, Path)
    if not str(source).strip():
        raise ValueError(f"source is {source!r}; expected the name of a published policy, or a path.")
    path = published_policies().get(str(source), Path(source))
    published = is_pretrained(path)
    path = path if published else find_checkpoint(path)
    info = pretrained_card(path) if published else checkpoint_info(path)
    if not isinstance(info.get("recipe", ""), str):
        raise CheckpointMismatch(f"{path} names the recipe {info['recipe']!r}; expected the path of a file.")
    origin = path / info["recipe"] if "recipe" in info else info["variant"]  # an absolute path stays as it is
    found = find_recipe(recipe or origin)
    if found.variant != info["variant"]:
        raise CheckpointMismatch(
            f"{path} is of variant {info['variant']!r}; expected a recipe of it, and {str(recipe or origin)!r} makes "
            f"{found.variant!r}. Name the recipe that trained it."
        )
    config = restored_config(found, info["config"], path)
    modules = found.make_modules(config)
    env = found.make_env(config, modules, num_envs=1)
    actor, _ = found.make_policy(config, env)
    env.close()
    (load_pretrained if published else load_checkpoint)(path, {"actor": actor, **modules})
    return Policy(found, config, modules, actor, Path(source))
