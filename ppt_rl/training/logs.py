"""The files of a run: configuration and logs."""

from __future__ import annotations

import glob
import json
import os
import platform
import re
import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torchrl.record.loggers import CSVLogger

from ppt_rl.training.advice import in_one_line
from ppt_rl.training.loggers import open_sinks, require_loggers

__all__ = [
    "RunLogs",
    "read_scalar",
    "remove_drafts",
    "save_config",
    "saved_config",
    "versions",
    "write_bytes_atomically",
    "write_text_atomically",
]

#: A complete line of a CSV file of scalars.
_LINE = re.compile(r"(\d+),([-+.\w]+)\n")
_PACKAGES = ("ppt_rl", "torch", "torchrl", "tensordict", "mujoco", "dm_control", "numpy")


class RunLogs:
    """Scalars of a run: ``logs/csv/scalars/NAME.csv`` (step, value), and what its loggers write.

    The CSV files are always there, since reports and ``--resume`` read them, and are written through at once. So a run
    that goes on keeps what they hold up to its checkpoint, and all that its other loggers wrote is cleared and written
    anew from them: each holds each step once.

    Args:
        run_dir: directory of the run.
        last_step: control step to continue from; entries that a killed run logged after it are dropped. At 0, all are.
        loggers: names of loggers, some of :data:`~ppt_rl.training.loggers.LOGGERS`.
        options: options of the run, for loggers that show them.

    Raises:
        ValueError: if a logger is unknown.
        MissingPackage: if the package of one is not installed.
    """

    def __init__(
        self,
        run_dir: Path,
        last_step: int = 0,
        *,
        loggers: Sequence[str] = ("csv", "tensorboard"),
        options: Mapping[str, Any] | None = None,
    ) -> None:
        require_loggers(loggers)
        logs = run_dir / "logs"
        kept = {path.stem: _trimmed(path, last_step) for path in sorted((logs / "csv" / "scalars").glob("*.csv"))}
        self._csv = CSVLogger(exp_name="csv", log_dir=str(logs))
        self._sinks = open_sinks(loggers, run_dir, options or {})
        for step in sorted(set().union(*kept.values())):
            scalars = {name: float(values[step]) for name, values in kept.items() if step in values}
            for sink in self._sinks:
                sink.write(scalars, step)

    def write(self, scalars: Mapping[str, float], step: int) -> None:
        """Log scalars.

        Args:
            scalars: values by name.
            step: control steps so far.
        """
        for name, value in scalars.items():
            self._csv.log_scalar(name, value, step=step)
        for sink in self._sinks:
            sink.write(scalars, step)

    def flush(self) -> None:
        """Write out what is still buffered."""
        for sink in self._sinks:
            sink.flush()

    def close(self) -> None:
        """Write out what is still buffered, and close.

        Raises:
            OSError: if a file cannot be written; what a CSV file could not take was told by :meth:`write`.
        """
        for file in self._csv.experiment.files.values():
            with suppress(OSError):
                file.close()
        with ExitStack() as stack:
            for sink in self._sinks:
                stack.callback(sink.close)


def _trimmed(path: Path, last_step: int) -> dict[int, str]:
    """Values of a CSV file by step, up to a step; the file is cut to them, and removed if there are none.

    A line that a kill has torn is dropped. It is always the last one, so it was written after the last checkpoint.
    """
    remove_drafts(path)
    lines = path.read_text(errors="replace").splitlines(keepends=True)
    whole = [match.groups() for match in map(_LINE.fullmatch, lines) if match]
    values = {int(step): value for step, value in whole if 0 < last_step >= int(step)}
    if values:
        write_text_atomically(path, "".join(f"{step},{value}\n" for step, value in values.items()))
    else:
        path.unlink()
    return values


def read_scalar(run_dir: Path, name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Read a logged scalar back.

    Args:
        run_dir: directory of the run.
        name: name of the scalar.

    Returns:
        Steps and values.

    Raises:
        ValueError: if it was never logged, or its file is damaged.
    """
    path = Path(run_dir) / "logs" / "csv" / "scalars" / f"{name}.csv"
    expected = "expected a line of step and value for each batch. Train first, or name the directory of a run"
    try:
        lines = path.read_text().splitlines()
        data = np.loadtxt(lines, delimiter=",", ndmin=2) if lines else np.zeros((0, 0))
    except (OSError, ValueError) as error:
        raise ValueError(f"{path} cannot be read ({in_one_line(error)}); {expected}.") from error
    if data.shape[1] != 2:
        raise ValueError(f"{path} has {data.shape[1]} columns; {expected}.")
    return data[:, 0], data[:, 1]


def save_config(run_dir: Path, config: Mapping[str, Any]) -> None:
    """Write ``config.json``: the configuration, the command, and the versions it ran with.

    Args:
        run_dir: directory of the run.
        config: JSON data.
    """
    record = {
        "config": dict(config),
        "command": [Path(sys.argv[0]).name, *sys.argv[1:]],
        "versions": versions(),
    }
    write_text_atomically(run_dir / "config.json", json.dumps(record, indent=2) + "\n")


def saved_config(run_dir: Path) -> dict[str, Any] | None:
    """The configuration in ``config.json``.

    Args:
        run_dir: directory of the run.

    Returns:
        JSON data, with ``variant``; None if there is none or it cannot be read.
    """
    try:
        config = json.loads((run_dir / "config.json").read_text())["config"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return config if isinstance(config, dict) else None


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that a result depends on.

    Returns:
        By name.
    """
    return {"python": platform.python_version(), **{name: version(name) for name in _PACKAGES}}


def write_text_atomically(path: Path, text: str) -> None:
    """Write a file atomically: it appears complete or not at all.

    Args:
        path: path of the file; its directory is created.
        text: content.
    """
    write_bytes_atomically(path, text.encode())


def write_bytes_atomically(path: Path, data: bytes) -> None:
    """Write a file atomically: it appears complete or not at all, after a power cut too.

    Args:
        path: path of the file; its directory is created.
        data: content.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with draft.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())  # the content is on the disk before the name is
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)


def remove_drafts(path: Path) -> None:
    """Remove what killed processes left of a file that they were writing atomically.

    Args:
        path: path of the file; no other process may be writing it.
    """
    for draft in path.parent.glob(f".{glob.escape(path.name)}.*"):
        if draft.suffix[1:].isdigit():
            draft.unlink(missing_ok=True)
