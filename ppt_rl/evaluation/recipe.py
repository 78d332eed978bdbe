"""A recipe: everything that makes a variant, and where recipes are found."""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import pkgutil
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from torch import nn
from torchrl.envs import Compose, Transform, TransformedEnv

from ppt_rl.envs import ArmEnv
from ppt_rl.evaluation.episodes import run_episodes
from ppt_rl.evaluation.task import Task
from ppt_rl.functional.argument_checks import require_instance
from ppt_rl.training import (
    CheckpointMismatch,
    Constraint,
    Learners,
    Validation,
    options_to_resume,
    prepare_torch,
    preset_options,
    run_script,
    train_in_run_dir,
)
from ppt_rl.training.output import tell

__all__ = ["Recipe", "find_recipe", "shipped_recipes"]

_PACKAGE, _PREFIX = "ppt_rl.recipes", "ppo_"
#: Seed of the episodes of a validation: neither training nor a reported evaluation takes it.
_VALIDATION_SEED = 30_000
#: Level and valve of the tank that films and reports show.
_TANK = ("tank_energy", "valve")


def _no_modules(config: Any) -> dict[str, nn.Module]:
    return {}


def _no_fit(config: Any, **modules: nn.Module) -> None:
    return None


@dataclass(frozen=True)
class Recipe:
    """Everything that makes a variant: its task, options, chain and networks.

    Attributes:
        variant: name of the variant, unique: ``ppt_push``.
        label: its name in tables and figures: ``PPT``.
        task: the task it learns.
        config: dataclass of its options, a subclass of :class:`~ppt_rl.training.RunConfig` with a property or field
            ``batch_steps``: policy steps of every environment in a batch.
        make_chain: from options, bare environment and modules (by name), the list of transforms.
        make_policy: from options and environment, actor and critic.
        make_modules: from options, what a checkpoint holds besides the networks, such as the movement primitive.
        fit: fits the modules before training, in place.
        has_tank: whether the chain has an energy tank with the options ``p_max`` and ``e_max``, which writes
            ``tank_energy`` and ``valve``.
        has_reference: whether an action of zero is a policy of its own, the reference alone.
        trace: observations of this chain to record besides those of the task and the tank.
        episode_keys: observations ``(*B, 1)`` at the end of an episode to keep for each, besides those of the task.
        make_constraint: from options and environment, the limit on the cost of an episode; None trains without one.
        in_study: whether the study of its task has it; else a study has to name it.
    """

    variant: str
    label: str
    task: Task
    config: type
    make_chain: Callable[..., list[Transform]]
    make_policy: Callable[[Any, TransformedEnv], tuple[nn.Module, nn.Module]]
    make_modules: Callable[[Any], Mapping[str, Any]] = _no_modules
    fit: Callable[..., None] = _no_fit
    has_tank: bool = False
    has_reference: bool = False
    trace: tuple[str, ...] = ()
    episode_keys: tuple[str, ...] = ()
    make_constraint: Callable[[Any, TransformedEnv], Constraint] | None = None
    in_study: bool = True

    @property
    def file(self) -> Path:
        """The file that defines the chain, which is that of the recipe."""
        return Path(inspect.getfile(self.make_chain)).resolve()

    @property
    def identity(self) -> dict[str, str]:
        """What a checkpoint says of its origin: the variant and, for a recipe of a user's own, its file."""
        shipped = self.file == shipped_recipes().get(self.variant)
        return {"variant": self.variant} if shipped else {"variant": self.variant, "recipe": str(self.file)}

    @property
    def traced(self) -> tuple[str, ...]:
        """Observations to record at every control step."""
        tank = _TANK if self.has_tank else ()
        return (*self.task.pictures.configuration, *self.task.pictures.trace, *tank, *self.trace)

    def on(self, base: ArmEnv, config: Any, modules: Mapping[str, nn.Module]) -> TransformedEnv:
        """An environment with the chain of this recipe.

        Args:
            base: bare environment of the task.
            config: options.
            modules: what :attr:`make_modules` returned.

        Returns:
            The environment.
        """
        for module in modules.values():
            module.to(base.device)
        env = TransformedEnv(base, Compose(*self.make_chain(config, base, **modules)).to(base.device))
        lacking = [key for key in _TANK if self.has_tank and key not in env.observation_spec.keys()]
        if lacking:
            raise ValueError(
                f"the recipe {self.variant} has_tank=True, but its chain writes no {lacking}; expected an "
                f"EnergyTankTransform with the usual out_keys {_TANK}, which films and reports read. Where the only "
                "tank stands at the motors, leave its out_keys as they are."
            )
        return env

    def make_env(
        self,
        config: Any,
        modules: Mapping[str, nn.Module],
        *,
        num_envs: int,
        seed: int | None = None,
        audit: bool = False,
        given: Sequence[Any] = (),
    ) -> TransformedEnv:
        """The environment of the test with the chain of this recipe.

        Args:
            config: options.
            modules: what :attr:`make_modules` returned.
            num_envs: number of environments that step together.
            seed: seed of the episodes; None draws one.
            audit: whether power and work are measured at the rate of the physics.
            given: episodes to run in turn, in the task's own form, instead of random ones.

        Returns:
            The environment.
        """
        base = self.task.make_test_env(config, num_envs=num_envs, seed=seed, audit=audit, given=given)
        return self.on(base, config, modules)

    def train(self, config: Any) -> Path:
        """Train in ``config.run_dir``, afresh or from its newest checkpoint.

        Args:
            config: options.

        Returns:
            Path of the last checkpoint.

        Raises:
            CheckpointMismatch: if the directory holds a run that is not to be resumed, or one that does not fit.
        """
        prepare_torch(config)
        modules = self.make_modules(config)
        self.fit(config, **modules)
        base = self.task.make_training_env(config, num_envs=config.num_envs, seed=config.seed, audit=False)
        self._advise(config, base)
        env = self.on(base, config, modules)
        policy = self.make_policy(config, env)
        constraint = None if self.make_constraint is None else self.make_constraint(config, env)
        learners = Learners(*policy, extra=modules, constraint=constraint)
        return train_in_run_dir(
            config, env, learners, policy_steps=config.batch_steps, identity=self.identity,
            validation=self._validation(config, modules, learners.actor),
        )  # fmt: skip

    def _advise(self, config: Any, base: ArmEnv) -> None:
        """Warn of an episode that is decided once, and whose end by the horizon is not the end for the critic."""
        if config.batch_steps == 1 and not base.horizon_terminates:
            warnings.warn(
                f"a batch of {self.variant} has one decision of each environment, and {type(base).__name__} has "
                "horizon_terminates=False, so the critic's guess of what comes after the horizon is added to every "
                "return. Set horizon_terminates = True in the environment where an episode is one decision.",
                stacklevel=2,
            )

    def _validation(self, config: Any, modules: Mapping[str, nn.Module], actor: nn.Module) -> Validation | None:
        """Validation in episodes of the test, the same ones every time."""
        if not config.validate_every:
            return None
        episodes = config.validation_episodes or config.num_envs
        env = self.make_env(config, modules, num_envs=min(episodes, config.num_envs), seed=_VALIDATION_SEED)

        def measure() -> dict[str, float]:
            env.set_seed(_VALIDATION_SEED)
            rows = run_episodes(env, actor, episodes)
            return {f"validation_{name}": float(rows[name].mean()) for name in ("success", "max_power")}

        return Validation(measure, config.validate_every)

    def main(self, args: Sequence[str] | None = None, prog: str | None = None) -> None:
        """Train with the options of a command line: what the recipe does as a script.

        With ``--resume``, options that are not given are those of the run.

        Args:
            args: command line; None takes that of the process.
            prog: name of the program in its help; None takes that of the process.
        """
        run_script(self._train_and_tell, self.config, args, prog, self._defaults)

    def _train_and_tell(self, config: Any) -> None:
        checkpoint = self.train(config)
        tell(f"The policy is in {checkpoint}. ppt-rl evaluate {config.run_dir} judges it.")

    def _defaults(self, args: Sequence[str]) -> Any:
        """Options of the run that a command line goes on with, or of the preset that it names."""
        resumed = options_to_resume(self.config, self.variant, args)
        preset = preset_options(self.config, args)
        if resumed is None or preset is None:
            return resumed or preset
        return replace(resumed, device=preset.device)


def shipped_recipes() -> dict[str, Path]:
    """Recipes that come with the library.

    Returns:
        Their files by variant, in alphabetical order.
    """
    package = importlib.import_module(_PACKAGE)
    folder = Path(package.__path__[0]).resolve()
    names = sorted(info.name for info in pkgutil.iter_modules(package.__path__) if info.name.startswith(_PREFIX))
    return {name.removeprefix(_PREFIX): folder / f"{name}.py" for name in names}


def find_recipe(name: str | Path) -> Recipe:
    """Find a recipe.

    Args:
        name: a variant that comes with the library, or the file of a recipe of your own, which defines ``RECIPE``.

    Returns:
        The recipe.

    Raises:
        CheckpointMismatch: if there is none of that name, or the file cannot be run or defines no recipe.
        ValueError: if it is neither a name nor a path.
    """
    require_instance("name", name, str, Path)
    known = shipped_recipes()
    if str(name) in known:
        return importlib.import_module(f"{_PACKAGE}.{_PREFIX}{name}").RECIPE
    path = Path(name).resolve()
    if path.suffix != ".py" or not path.is_file():
        raise CheckpointMismatch(
            f"recipe {str(name)!r} is unknown; expected one of {list(known)}, or the file (.py) of a recipe."
        )
    shipped = {file: variant for variant, file in known.items()}
    return find_recipe(shipped[path]) if path in shipped else _recipe_of_file(path)


def _recipe_of_file(path: Path) -> Recipe:
    """The recipe that a user's file defines; it may import its neighbours, as when it is run as a script."""
    module_name = f"ppt_rl_user_recipe_{path.stem}_{abs(hash(path))}"
    module = sys.modules.get(module_name)
    if module is None:
        if str(path.parent) not in sys.path:
            sys.path.insert(0, str(path.parent))
        spec = importlib.util.spec_from_file_location(module_name, path)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[module_name] = module
        try:
            spec.loader.exec_module(module)
        except Exception as error:
            del sys.modules[module_name]
            what = " ".join(str(error).split())
            raise CheckpointMismatch(
                f"{path} cannot be run: {type(error).__name__}: {what}; expected a recipe. Repair it, and try it with "
                f"python {path.name} --help."
            ) from error
    recipe = getattr(module, "RECIPE", None)
    if not isinstance(recipe, Recipe):
        raise CheckpointMismatch(f"{path} defines no recipe; expected RECIPE = Recipe(...) at its top level.")
    return recipe
