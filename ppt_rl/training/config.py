"""Options of a training run, and their JSON form."""

from __future__ import annotations

import json
import typing
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, asdict, dataclass, field, fields, is_dataclass, replace
from itertools import pairwise
from pathlib import Path
from types import NoneType
from typing import Any, ClassVar, Literal, TypeVar

import torch

from ppt_rl.functional.argument_checks import require_instance
from ppt_rl.functional.checks import Bounds, require_at_most, require_bounds
from ppt_rl.training.loggers import require_loggers
from ppt_rl.training.ppo import PPOConfig

__all__ = ["RunConfig", "as_json", "from_json", "prepare_torch", "preset_options", "with_settings"]

_Config = TypeVar("_Config")
#: Names of the presets of every recipe.
Preset = Literal["none", "gpu"]
#: Marks a field that says how this process starts, and nothing of the run: its JSON form leaves it out.
_NOT_RECORDED = {"recorded": False}
#: Policy steps of a batch that fit into the memory of a large machine.
_MAX_BATCH = 10_000_000


@dataclass(frozen=True)
class RunConfig:
    """Options of every training run.

    Attributes:
        run_dir: directory of logs, checkpoints and figures.
        seed: seed of everything random.
        resume: continue from the newest checkpoint in run_dir, with its options; without one, start afresh.
        num_envs: number of environments that step together.
        num_threads: physics threads; 0 takes one per CPU.
        torch_threads: threads of torch during the simulation; its tensors are small, so more than one gains nothing.
        update_threads: threads of an update of PPO; 0 takes one per CPU, and fewer for a small batch.
        validate_every: batches from one validation of the deterministic policy to the next; 0 validates never.
        validation_episodes: episodes of a validation, the same ones every time; 0 takes one of each environment.
        logger: where scalars are logged: csv (always), tensorboard, wandb (offline), mlflow; several may be given.
        ppo: settings of PPO.
        resume_from: continue from this checkpoint of run_dir, or of another run where run_dir holds none.
        device: where the physics, the networks and the batches are, such as ``cuda``.
        engine: engine of the physics; ``auto`` takes ``warp`` on a GPU and ``threads`` on the CPU.
        preset: other defaults: ``gpu`` are those for training on a GPU. Options that are given stay as they are.
    """

    run_dir: Path = Path("runs/run")
    seed: int = 0
    resume: bool = False
    num_envs: int = 128
    num_threads: int = 0
    torch_threads: int = 1
    update_threads: int = 0
    validate_every: int = 0
    validation_episodes: int = 0
    logger: tuple[str, ...] = ("csv", "tensorboard")
    ppo: PPOConfig = field(default_factory=PPOConfig)
    resume_from: Path | None = field(default=None, metadata=_NOT_RECORDED, kw_only=True)
    device: str = field(default="cpu", metadata=_NOT_RECORDED, kw_only=True)
    engine: Literal["auto", "threads", "warp"] = field(default="auto", metadata=_NOT_RECORDED, kw_only=True)
    preset: Preset = field(default="none", metadata=_NOT_RECORDED, kw_only=True)

    #: Other defaults by the name of a preset, as :func:`with_settings` takes them.
    presets: ClassVar[dict[str, dict[str, str]]] = {
        "gpu": {"device": "cuda", "num_envs": "4096", "ppo.minibatches": "16", "ppo.target_kl": "0.06"}
    }

    bounds: ClassVar[dict[str, Bounds]] = {
        "seed": Bounds(0, 2**32 - 1),
        "num_envs": Bounds(1, 16_384),
        "num_threads": Bounds(0, 1024),
        "torch_threads": Bounds(1, 1024),
        "update_threads": Bounds(0, 1024),
        "validate_every": Bounds(0, 10**9, "batches"),
        "validation_episodes": Bounds(0, 1_000_000),
        "batch_steps": Bounds(1, 100_000, "policy steps"),
        "initial_scale": Bounds(1e-6, 1e3),
    }

    def __post_init__(self) -> None:
        """Refuse numbers out of bounds, and batches that no machine could hold; ``bounds`` of subclasses add up."""
        tables = [vars(kind).get("bounds", {}) for kind in reversed(type(self).__mro__)]
        require_bounds(self, {name: limits for table in tables for name, limits in table.items()})
        require_loggers(self.logger)
        batch = self.num_envs * getattr(self, "batch_steps", 1)
        require_at_most("num_envs * batch_steps", batch, _MAX_BATCH, "lower num_envs or the policy steps of a batch")

    def implied(self, changes: Mapping[str, Any]) -> dict[str, Any]:
        """Further fields that change with some fields, such as defaults that depend on one of them.

        Args:
            changes: new values by field.

        Returns:
            New values by field; those in ``changes`` go before them.
        """
        return {}


def preset_options(options: type[RunConfig], args: Sequence[str]) -> RunConfig | None:
    """The options with the defaults of the preset that a command line names.

    Args:
        options: dataclass of a recipe's options.
        args: command line.

    Returns:
        The options; None if it names none, or an unknown one, which the parse of the command line explains.
    """
    name = next((value for flag, value in pairwise(args) if flag == "--preset"), None)
    name = next((arg.partition("=")[2] for arg in args if arg.startswith("--preset=")), name)
    return with_settings(options(), options.presets[name]) if name in options.presets else None


def prepare_torch(config: RunConfig) -> None:
    """Seed torch and set its number of threads.

    Args:
        config: options of the run.
    """
    torch.set_num_threads(config.torch_threads)
    torch.manual_seed(config.seed)


def as_json(config: Any) -> dict[str, Any]:
    """Convert a configuration dataclass to plain JSON data.

    Args:
        config: dataclass instance; paths become strings, tuples become lists.

    Returns:
        Its fields, nested.

    Raises:
        TypeError: if it is not a dataclass instance.
    """
    if not is_dataclass(config) or isinstance(config, type):
        raise TypeError(f"config is a {type(config).__name__}; expected a dataclass instance.")
    recorded = _recorded(type(config))
    return json.loads(json.dumps({k: v for k, v in asdict(config).items() if k in recorded}, default=str))


def from_json(config_class: type[_Config], settings: Mapping[str, Any]) -> _Config:
    """Rebuild a configuration dataclass from its JSON form.

    Args:
        config_class: the dataclass.
        settings: what :func:`as_json` returned, here or in an older version: a field that is missing takes its
            default, if it has one.

    Returns:
        The configuration.

    Raises:
        ValueError: if a field without a default is missing, a field is unknown, or a value is impossible.
    """
    hints = typing.get_type_hints(config_class)
    known = _recorded(config_class)
    members = fields(config_class)  # type: ignore[arg-type]
    needed = known & {f.name for f in members if f.default is MISSING and f.default_factory is MISSING}
    if not needed <= set(settings) <= known:
        raise ValueError(
            f"the settings of {config_class.__name__} have no {sorted(needed - set(settings))} and unknown "
            f"{sorted(set(settings) - known)}; expected the fields {sorted(known)}."
        )
    try:
        return config_class(**{name: _restored(name, hints[name], value) for name, value in settings.items()})
    except TypeError as error:
        raise ValueError(f"a setting of {config_class.__name__} does not fit: {error}.") from error


def _recorded(config_class: type) -> set[str]:
    """Names of the fields that belong to the JSON form."""
    return {f.name for f in fields(config_class) if f.metadata.get("recorded", True)}


def with_settings(config: _Config, settings: Mapping[str, str]) -> _Config:
    """A configuration with some fields replaced, as given on a command line.

    Args:
        config: dataclass instance.
        settings: text by field name; ``ppo.gamma`` names a field of a nested dataclass. Several values of a tuple are
            separated by commas.

    Returns:
        The new configuration.

    Raises:
        ValueError: if a field is unknown or its text does not fit its type.
    """
    hints = typing.get_type_hints(type(config))
    changes: dict[str, Any] = {}
    for name, text in settings.items():
        head, _, rest = name.partition(".")
        if head not in hints:
            raise ValueError(f"option {name!r} is unknown; expected one of {sorted(hints)}.")
        old = changes.get(head, getattr(config, head))
        if rest and not is_dataclass(old):
            raise ValueError(f"option {name!r} is unknown, since {head} is a value; expected {head}=VALUE.")
        changes[head] = with_settings(old, {rest: text}) if rest else _parsed(name, hints[head], text)
    implied = config.implied(changes) if isinstance(config, RunConfig) else {}
    return replace(config, **{**implied, **changes})  # type: ignore[type-var]


def _restored(name: str, hint: Any, value: Any) -> Any:
    """A JSON value in the type of its field."""
    is_tuple = typing.get_origin(hint) is tuple
    needed = (
        [Mapping] if is_dataclass(hint) else [list, tuple] if is_tuple else [str, Path] if hint is Path else [object]
    )
    require_instance(name, value, *needed)
    if is_dataclass(hint):
        return from_json(hint, value)  # type: ignore[arg-type]
    if is_tuple:
        return tuple(_restored(f"an entry of {name}", typing.get_args(hint)[0], item) for item in value)
    return Path(value) if hint is Path else value


def _parsed(name: str, hint: Any, text: str) -> Any:
    """Text of a command line in the type of its field."""
    options = typing.get_args(hint)
    if typing.get_origin(hint) is tuple:
        return tuple(_parsed(name, options[0], part) for part in text.split(",") if part)
    if NoneType in options:
        return None if text.lower() == "none" else _parsed(name, options[0], text)
    if typing.get_origin(hint) is typing.Literal:
        if text not in options:
            raise ValueError(f"option {name} is {text!r}; expected one of {list(options)}.")
        return text
    try:
        if hint is bool:
            return {"true": True, "false": False}[text.lower()]
        return hint(text)
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"option {name} is {text!r}; expected {getattr(hint, '__name__', hint)}.") from error
