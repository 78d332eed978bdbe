"""The files of a run: configuration, CSV and TensorBoard logs."""

from __future__ import annotations

import json
import os
import platform
import sys
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torchrl.record.loggers import CSVLogger, TensorboardLogger

__all__ = ["RunLogs", "read_scalar", "save_config", "versions", "write_bytes_atomically", "write_text_atomically"]

_PACKAGES = ("ppt_rl", "torch", "torchrl", "tensordict", "mujoco", "dm_control", "pytorch_kinematics", "numpy")


class RunLogs:
    """Scalars of a run: ``logs/csv/scalars/NAME.csv`` (step, value) and ``logs/tensorboard``.

    Args:
        run_dir: directory of the run.
        last_step: control step to continue from; entries that a killed run logged after it are dropped.
    """

    def __init__(self, run_dir: Path, last_step: int = 0) -> None:
        logs = str(run_dir / "logs")
        for path in (run_dir / "logs" / "csv" / "scalars").glob("*.csv"):
            lines = path.read_text().splitlines(keepends=True)
            write_text_atomically(path, "".join(line for line in lines if int(line.split(",")[0]) <= last_step))
        self._loggers = [
            CSVLogger(exp_name="csv", log_dir=logs),
            TensorboardLogger(exp_name="tensorboard", log_dir=logs),
        ]

    def write(self, scalars: Mapping[str, float], step: int) -> None:
        """Log scalars.

        Args:
            scalars: values by name.
            step: control steps so far.
        """
        for logger in self._loggers:
            for name, value in scalars.items():
                logger.log_scalar(name, value, step=step)

    def close(self) -> None:
        """Flush."""
        self._loggers[1].experiment.flush()


def read_scalar(run_dir: Path, name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Read a logged scalar back.

    Args:
        run_dir: directory of the run.
        name: name of the scalar.

    Returns:
        Steps and values.

    Raises:
        FileNotFoundError: if it was never logged.
    """
    path = run_dir / "logs" / "csv" / "scalars" / f"{name}.csv"
    data = np.loadtxt(path, delimiter=",", ndmin=2)
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
    """Write a file atomically: it appears complete or not at all.

    Args:
        path: path of the file; its directory is created.
        data: content.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    draft.write_bytes(data)
    draft.replace(path)
