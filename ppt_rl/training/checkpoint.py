"""Checkpoints of a run: one archive each, written atomically, without pickled code, checked before use."""

from __future__ import annotations

import errno
import os
import tempfile
import warnings
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torchrl.checkpoint import Checkpoint, CheckpointError, CheckpointRotation

from ppt_rl.training.advice import in_one_line
from ppt_rl.training.finite import TrainingDiverged, first_not_finite, size_of

__all__ = [
    "CheckpointMismatch",
    "all_checkpoints",
    "checkpoint_info",
    "find_checkpoint",
    "load_checkpoint",
    "newest_checkpoint",
    "rotation",
    "save_checkpoint",
    "step_of",
]

#: What a file that is no intact archive makes its readers raise.
_UNREADABLE = (OSError, ValueError, KeyError, TypeError, AttributeError, RuntimeError, EOFError, zlib.error,
               zipfile.BadZipFile, CheckpointError)  # fmt: skip
#: Room that a checkpoint takes beside its tensors: manifest, random-number generators, blocks that are not full [B].
_OVERHEAD = 2**21


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

    Raises:
        TrainingDiverged: before anything is written, if a number in the components is NaN or infinite.
        OSError: if it cannot be written; the older checkpoints stay as they are.
    """
    broken = first_not_finite(components)
    if broken is not None:
        raise TrainingDiverged(f"{broken} is not finite")
    saved = rotation(run_dir)
    saved.directory.mkdir(parents=True, exist_ok=True)
    _require_room(saved.directory, components)
    return saved.save(Checkpoint(format="archive", **components), step=step, metadata=dict(metadata))


def _require_room(folder: Path, components: Mapping[str, Any]) -> None:
    """Raise OSError unless the disk has room for a checkpoint, once as loose files and once as an archive.

    torchrl maps the loose files into memory: on a full disk the system kills a process that writes to them.
    """
    size = 2 * size_of(components) + _OVERHEAD
    if not hasattr(os, "posix_fallocate"):
        return
    with tempfile.TemporaryFile(dir=folder) as trial:
        try:
            os.posix_fallocate(trial.fileno(), 0, size)
        except OSError as error:
            if error.errno not in (errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS):  # file systems without reservations
                raise OSError(error.errno, error.strerror, str(folder)) from error


def all_checkpoints(run_dir: Path) -> list[Path]:
    """Checkpoints of a run, whether they can be read or not; what a killed process left unfinished is none.

    Args:
        run_dir: directory of the run.

    Returns:
        Paths, the newest first.
    """
    found = rotation(run_dir).directory.glob("checkpoint-*")
    return sorted((path for path in found if _step_text(path).isdigit()), key=step_of, reverse=True)


def step_of(path: Path) -> int:
    """Control steps after which a checkpoint of a run was written, from its name.

    Args:
        path: the checkpoint.

    Returns:
        The number.
    """
    return int(_step_text(path))


def _step_text(path: Path) -> str:
    return path.name.removesuffix(".torchrl").removeprefix("checkpoint-")


def newest_checkpoint(run_dir: Path) -> Path | None:
    """The newest checkpoint of a run that can be read; warns where a newer one cannot.

    Args:
        run_dir: directory of the run.

    Returns:
        Its path, or None if the run has written none.

    Raises:
        CheckpointMismatch: if there are some and none can be read.
    """
    damaged = []
    for path in all_checkpoints(run_dir):
        try:
            checkpoint_info(path)
        except CheckpointMismatch as error:
            damaged.append((path.name, error))
            continue
        if damaged:
            names = ", ".join(name for name, _ in damaged)
            warnings.warn(f"{run_dir}: {names} cannot be read; {path.name} is taken in its place.", stacklevel=2)
        return path
    if damaged:
        raise CheckpointMismatch(
            f"{run_dir} holds {len(damaged)} checkpoints and none can be read: {damaged[0][1]} Take a copy from a "
            f"backup, start another run with --run-dir, or delete {run_dir / 'checkpoints'} to start this one afresh."
        )
    return None


def find_checkpoint(path: Path) -> Path:
    """Resolve a path to a checkpoint: the path itself, or the newest checkpoint of a run that can be read.

    Args:
        path: a checkpoint, or a run's directory.

    Returns:
        Path of the checkpoint.

    Raises:
        CheckpointMismatch: if there is none.
    """
    if path.is_dir() and not (path / "manifest.json").exists():
        newest = newest_checkpoint(path)
        if newest is None:
            raise CheckpointMismatch(
                f"{path} holds no checkpoint; expected a checkpoint, or a run's directory with checkpoints/ in it."
            )
        return newest
    if not path.exists():
        raise CheckpointMismatch(f"{path} does not exist; expected a checkpoint or a run's directory.")
    return path


def checkpoint_info(path: Path, variant: str | None = None) -> dict[str, Any]:
    """Metadata of a checkpoint, read without loading it; every byte of an archive is compared with its checksum.

    Args:
        path: the checkpoint.
        variant: required variant; None accepts any.

    Returns:
        The metadata: ``variant``, ``config``, ``success``, and ``recipe`` where it is a user's file.

    Raises:
        CheckpointMismatch: if it is unreadable, incomplete, or of another variant.
    """
    try:
        metadata = Checkpoint.manifest(path).get("metadata", {})
        broken = _broken_member(path)
    except _UNREADABLE as error:
        raise CheckpointMismatch(
            f"{path} cannot be read as a checkpoint ({in_one_line(error)}); it may be truncated. Use another "
            "checkpoint of the run."
        ) from error
    if broken is not None:
        raise CheckpointMismatch(f"{path} is damaged in {broken}; use another checkpoint of the run.")
    if (
        not isinstance(metadata, Mapping)
        or not isinstance(metadata.get("config"), Mapping)
        or "variant" not in metadata
    ):
        raise CheckpointMismatch(f"{path} is not a checkpoint of this library: its metadata names no variant.")
    if variant is not None and metadata["variant"] != variant:
        raise CheckpointMismatch(
            f"{path} is of variant {metadata['variant']!r}; expected {variant!r}. Use the recipe that trained it."
        )
    return dict(metadata)


def _broken_member(path: Path) -> str | None:
    """The first file of an archive that differs from its checksum."""
    if not path.is_file():
        return None
    with zipfile.ZipFile(path) as archive:
        return archive.testzip()


def load_checkpoint(path: Path, components: Mapping[str, Any]) -> dict[str, Any]:
    """Load components of a checkpoint into live objects.

    Args:
        path: the checkpoint.
        components: objects to fill, by name; the checkpoint may hold more.

    Returns:
        Values of the components that are plain data.

    Raises:
        CheckpointMismatch: if a component is missing, does not fit or is not finite.
    """
    try:
        values = Checkpoint(**components).load(path).values
    except _UNREADABLE as error:
        raise CheckpointMismatch(
            f"{path} does not fit ({in_one_line(error)}); expected a checkpoint of the same variant, network and "
            "primitive."
        ) from error
    broken = first_not_finite({**components, **values})
    if broken is not None:
        raise CheckpointMismatch(f"{path} holds numbers that are not finite in {broken}; use an older checkpoint.")
    return values
