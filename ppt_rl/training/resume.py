"""The options of a run that goes on: those it was started with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import tyro

from ppt_rl.training.checkpoint import CheckpointMismatch, checkpoint_info, find_checkpoint, newest_checkpoint
from ppt_rl.training.config import from_json
from ppt_rl.training.logs import saved_config
from ppt_rl.training.output import tell

__all__ = ["options_to_resume"]


@dataclass(frozen=True)
class _Place:
    """What a command line says of the place of a run and of going on with it."""

    run_dir: Path
    resume: bool = False
    resume_from: Path | None = None


def options_to_resume(options: type, variant: str, args: Sequence[str]) -> Any:
    """Options of the run that a command line goes on with, so that none must be typed again.

    They are those in the run's ``config.json``; where that cannot be read, or a checkpoint is named, those in the
    checkpoint.

    Args:
        options: dataclass of the recipe's options.
        variant: name of the variant.
        args: command line.

    Returns:
        The options, which do not resume by themselves; None if the command line begins a run.

    Raises:
        CheckpointMismatch: if the run is of another variant, or its options are of another version of the recipe.
    """
    place = _place(options, args)
    if place is None or not (place.resume or place.resume_from):
        return None
    if place.resume_from is not None:
        saved = _of_checkpoint(options, variant, find_checkpoint(place.resume_from))
    else:
        saved = _of_run(options, variant, place.run_dir)
    return saved and replace(saved, run_dir=place.run_dir, resume=False, resume_from=None)


def _place(options: type, args: Sequence[str]) -> _Place | None:
    """The place on a command line; None if it cannot be read, which the full parse explains."""
    run_dir: Any = next(f.default for f in fields(options) if f.name == "run_dir")
    try:
        return tyro.cli(
            _Place, args=args, default=_Place(run_dir), return_unknown_args=True, add_help=False, console_outputs=False
        )[0]
    except SystemExit:
        return None


def _of_run(options: type, variant: str, run_dir: Path) -> Any:
    """Options in ``config.json``, else in the newest checkpoint, else None."""
    settings = saved_config(run_dir)
    if settings is not None:
        with suppress(ValueError):
            return _restored(options, variant, settings, run_dir / "config.json")
    newest = newest_checkpoint(run_dir)
    if newest is None:
        return None
    tell(f"{run_dir / 'config.json'} cannot be read; the options are taken from {newest.name}.")
    return _of_checkpoint(options, variant, newest)


def _of_checkpoint(options: type, variant: str, path: Path) -> Any:
    info = checkpoint_info(path, variant)
    try:
        return _restored(options, variant, info["config"], path)
    except ValueError as error:
        raise CheckpointMismatch(f"{path} was written by another version of {variant}: {error}") from error


def _restored(options: type, variant: str, settings: Mapping[str, Any], path: Path) -> Any:
    """Options from their JSON form."""
    found = settings.get("variant", variant)
    if found != variant:
        raise CheckpointMismatch(
            f"{path} is of variant {found!r}; expected {variant!r}. Use the recipe that trained it."
        )
    return from_json(options, {key: value for key, value in settings.items() if key not in ("variant", "recipe")})
