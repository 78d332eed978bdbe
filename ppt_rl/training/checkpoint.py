"""Checkpoints of a run: one archive each, written atomically, without pickled code, checked before use."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torchrl.checkpoint import Checkpoint, CheckpointError, CheckpointRotation

__all__ = ["CheckpointMismatch", "checkpoint_info", "find_checkpoint", "load_checkpoint", "rotation", "save_checkpoint"]


class CheckpointMismatch(RuntimeError):
    """Raised for a checkpoint that is unreadable or does not belong to what tries to load it."""


def rotation(run_dir: Path, keep_last: int = 2) -> CheckpointRotation:
    """Checkpoints of a run: the newest, and the best by training success.

    Args:
        run_dir: directory of the run.
        keep_last: number of newest checkpoints to keep.

    Returns:
        torchrl's rotation over ``run_dir/checkpoints``.
    """
    return CheckpointRotation(run_dir / "checkpoints", keep_last=keep_last, keep_best=("success", "max"))


def save_checkpoint(run_dir: Path, components: Mapping[str, Any], *, step: int, metadata: Mapping[str, Any]) -> Path:
    """Write a checkpoint atomically and drop old ones.

    Args:
        run_dir: directory of the run.
        components: what to save: modules, optimisers and JSON values by name.
        step: control steps so far.
        metadata: JSON data beside them: ``variant`` and ``config`` of the run, and ``success`` [0-1], by which the best
            checkpoint is kept.

    Returns:
        Path of the archive.
    """
    return rotation(run_dir).save(Checkpoint(format="archive", **components), step=step, metadata=dict(metadata))


def find_checkpoint(path: Path) -> Path:
    """Resolve a path to a checkpoint: the path itself, or the newest checkpoint of a run directory.

    Args:
        path: a checkpoint, or a run's directory.

    Returns:
        Path of the checkpoint.

    Raises:
        CheckpointMismatch: if there is none.
    """
    if path.is_dir() and not (path / "manifest.json").exists():
        latest = rotation(path).latest()
        if latest is None:
            raise CheckpointMismatch(
                f"{path} holds no checkpoint; expected a checkpoint, or a run's directory with checkpoints/ in it."
            )
        return latest
    if not path.exists():
        raise CheckpointMismatch(f"{path} does not exist; expected a checkpoint or a run's directory.")
    return path


def checkpoint_info(path: Path, variant: str | None = None) -> dict[str, Any]:
    """Metadata of a checkpoint, read without loading it.

    Args:
        path: the checkpoint.
        variant: required variant; None accepts any.

    Returns:
        The metadata: ``variant``, ``config``, ``success``, and ``recipe`` where it is a user's file.

    Raises:
        CheckpointMismatch: if it is unreadable, incomplete, or of another variant.
    """
    try:
        manifest = Checkpoint.manifest(path)
        if path.is_file():
            with zipfile.ZipFile(path) as archive:
                broken = archive.testzip()
            if broken is not None:
                raise CheckpointMismatch(f"{path} is damaged in {broken}; use another checkpoint of the run.")
    except (OSError, ValueError, KeyError, CheckpointError, zipfile.BadZipFile) as error:
        raise CheckpointMismatch(
            f"{path} cannot be read as a checkpoint ({error}); it may be truncated. Use another checkpoint of the run."
        ) from error
    metadata = manifest.get("metadata", {})
    if "variant" not in metadata or "config" not in metadata:
        raise CheckpointMismatch(f"{path} is not a checkpoint of this library: its metadata names no variant.")
    if variant is not None and metadata["variant"] != variant:
        raise CheckpointMismatch(
            f"{path} is of variant {metadata['variant']!r}; expected {variant!r}. Use the recipe that trained it."
        )
    return metadata


def load_checkpoint(path: Path, components: Mapping[str, Any]) -> dict[str, Any]:
    """Load components of a checkpoint into live objects.

    Args:
        path: the checkpoint.
        components: objects to fill, by name; the checkpoint may hold more.

    Returns:
        Values of the components that are plain data.

    Raises:
        CheckpointMismatch: if a component is missing or does not fit.
    """
    try:
        return Checkpoint(**components).load(path).values
    except (CheckpointError, RuntimeError, OSError, ValueError, zipfile.BadZipFile) as error:
        raise CheckpointMismatch(
            f"{path} does not fit ({error}); expected a checkpoint of the same variant, network and primitive."
        ) from error
