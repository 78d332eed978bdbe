"""Checkpoints of a run: one archive a step, written atomically, no pickled code, checked before use."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torchrl.checkpoint import Checkpoint, CheckpointError, CheckpointRotation

__all__ = ["CheckpointMismatch", "checkpoint_info", "find_checkpoint", "load_checkpoint", "rotation", "save_checkpoint"]


class CheckpointMismatch(RuntimeError):
    """A checkpoint that is unreadable, or of something else than what asked for it."""


def rotation(run_dir: Path, keep_last: int = 2) -> CheckpointRotation:
    """Checkpoints of a run: the newest, and the best by training success.

    Args:
        run_dir: directory of the run.
        keep_last: how many of the newest are kept.

    Returns:
        torchrl's rotation over ``run_dir/checkpoints``.
    """
    return CheckpointRotation(run_dir / "checkpoints", keep_last=keep_last, keep_best=("success", "max"))


def save_checkpoint(
    run_dir: Path, components: Mapping[str, Any], *, step: int, variant: str, config: Mapping[str, Any], success: float
) -> Path:
    """Write a checkpoint atomically and drop old ones.

    Args:
        run_dir: directory of the run.
        components: what to save: modules, optimizers and JSON values by name.
        step: control steps so far.
        variant: name of the recipe's variant.
        config: configuration of the run, JSON-compatible.
        success: training success, by which the best is kept [0-1].

    Returns:
        Path of the archive.
    """
    metadata = {"variant": variant, "config": dict(config), "success": success}
    return rotation(run_dir).save(Checkpoint(format="archive", **components), step=step, metadata=metadata)


def find_checkpoint(path: Path) -> Path:
    """The checkpoint that a path stands for: itself, or the newest of a run directory.

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
    """Variant, configuration and success of a checkpoint, without loading it.

    Args:
        path: the checkpoint.
        variant: what it must be; None takes any.

    Returns:
        The metadata: ``variant``, ``config``, ``success``.

    Raises:
        CheckpointMismatch: if it is unreadable, incomplete, or of another variant.
    """
    try:
        manifest = Checkpoint.manifest(path)
        if path.is_file():
            with zipfile.ZipFile(path) as archive:
                broken = archive.testzip()
            if broken is not None:
                raise CheckpointMismatch(f"{path} is damaged in {broken}; take another checkpoint of the run.")
    except (OSError, ValueError, KeyError, CheckpointError, zipfile.BadZipFile) as error:
        raise CheckpointMismatch(
            f"{path} cannot be read as a checkpoint ({error}); it may be truncated. Take another one of the run."
        ) from error
    metadata = manifest.get("metadata", {})
    if "variant" not in metadata or "config" not in metadata:
        raise CheckpointMismatch(f"{path} is no checkpoint of this library: it names no variant.")
    if variant is not None and metadata["variant"] != variant:
        raise CheckpointMismatch(
            f"{path} is of variant {metadata['variant']!r}; expected {variant!r}. Use the recipe it was trained with."
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
