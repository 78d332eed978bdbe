"""The directory of a run: one process at a time, no leftovers of killed ones, and where a run goes on from."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from ppt_rl.training.checkpoint import (
    CheckpointMismatch,
    all_checkpoints,
    find_checkpoint,
    newest_checkpoint,
    rotation,
    step_of,
)
from ppt_rl.training.config import RunConfig
from ppt_rl.training.logs import remove_drafts
from ppt_rl.training.output import tell

__all__ = ["checkpoint_to_resume", "only_process_in", "remove_leftovers", "set_aside_newer"]

#: Names of torchrl's unfinished files: what is written, packed, replaced or deleted.
_UNFINISHED = re.compile(
    r"\.(?P<name>checkpoint-\d+(?:\.torchrl)?)\.(?P<state>stage|archive|backup|delete)-[0-9a-f]{32}"
)


@contextmanager
def only_process_in(run_dir: Path) -> Iterator[None]:
    """Hold a run's directory, which is created, for this process alone; the system lets go of it when it ends or dies.

    Args:
        run_dir: directory of the run.

    Raises:
        CheckpointMismatch: if another process holds it.
    """
    run_dir.mkdir(parents=True, exist_ok=True)
    lock = FileLock(run_dir / ".lock", blocking=False)
    try:
        lock.acquire()
    except Timeout:
        raise CheckpointMismatch(
            f"{run_dir} is in use by another process; expected one process a run. Wait for it to end, or name another "
            "directory with --run-dir."
        ) from None
    try:
        yield
    finally:
        lock.release()


def remove_leftovers(run_dir: Path) -> None:
    """Remove what killed processes left unfinished, and bring back a checkpoint that was just being replaced.

    Args:
        run_dir: directory of the run, held by this process.
    """
    remove_drafts(run_dir / "config.json")
    folder = rotation(run_dir).directory
    for path in sorted(folder.glob(".checkpoint-*")):
        found = _UNFINISHED.fullmatch(path.name)
        if found and found["state"] == "backup" and not (folder / found["name"]).exists():
            path.replace(folder / found["name"])
        elif found and path.is_dir():
            shutil.rmtree(path)
        elif found:
            path.unlink()


def checkpoint_to_resume(config: RunConfig) -> Path | None:
    """The checkpoint that a run goes on from.

    Args:
        config: options of the run; its directory is held by this process.

    Returns:
        Path of the checkpoint, or None if the run begins.

    Raises:
        CheckpointMismatch: if the directory holds a run that is not to be resumed, or the checkpoint does not exist.
    """
    run_dir = Path(config.run_dir)
    if config.resume_from is not None:
        return _chosen(run_dir, Path(config.resume_from))
    if config.resume:
        newest = newest_checkpoint(run_dir)
    elif all_checkpoints(run_dir):
        raise CheckpointMismatch(
            f"{run_dir} holds a run already. Continue it with --resume, or name another directory with --run-dir."
        )
    else:
        newest = None
    if newest is None and (config.resume or any(run_dir.glob("logs/*"))):
        tell(f"{run_dir} holds no checkpoint yet: the run starts afresh.")
    return newest


def _chosen(run_dir: Path, path: Path) -> Path:
    """The checkpoint that the user chose: of this run, or of another one for a directory that holds none."""
    found = find_checkpoint(path)
    own = all_checkpoints(run_dir)
    same = [checkpoint for checkpoint in own if checkpoint.resolve() == found.resolve()]
    if own and not same:
        raise CheckpointMismatch(
            f"--resume-from is {path}, and {run_dir} holds another run; expected one of its own checkpoints "
            f"({', '.join(checkpoint.name for checkpoint in own)}), or a directory without a run in --run-dir."
        )
    return same[0] if same else found


def set_aside_newer(run_dir: Path, checkpoint: Path) -> None:
    """Move checkpoints newer than the one that a run goes on from into ``checkpoints/superseded``; says so.

    Args:
        run_dir: directory of the run, held by this process.
        checkpoint: what the run goes on from.
    """
    newer = [path for path in all_checkpoints(run_dir) if step_of(path) > step_of(checkpoint)]
    folder = rotation(run_dir).directory / "superseded"
    for path in newer:
        folder.mkdir(exist_ok=True)
        path.replace(folder / path.name)
    if newer:
        tell(f"{', '.join(path.name for path in newer)} moved to {folder}: the run goes on from {checkpoint.name}.")
