"""Seconds of training until a policy succeeds: how fast a machine, an engine or a setting learns a task.

Reads a finished or a running training, on whatever device it ran. The success is that of the deterministic policy in
its validation, so the run needs ``--validate-every``; the clock counts everything since the run began but the imports.
``python recipes/ppo_ppt_push.py --preset gpu --run-dir runs/gpu && python benchmarks/time_to_success.py runs/gpu``
"""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from ppt_rl.training import run_script

#: What torchrl's CSV logger writes of a run: control steps and value.
_SCALARS = Path("logs/csv/scalars")
_VALIDATED = ("validation_success", "validation_max_power")


@dataclass(frozen=True)
class Config:
    """Tell when a training run first reached a success.

    Attributes:
        run: directory of a training run, or of a run that a study keeps.
        success: share of successful episodes in a validation [-].
        json: print one line of JSON only.
    """

    run: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RUN")]
    success: float = 0.95
    json: bool = False


def curve(run: Path, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Control steps and values of a logged quantity.

    Args:
        run: directory of the run.
        name: of the quantity, such as ``seconds`` or ``validation_success``.

    Returns:
        ``(N,)`` steps and ``(N,)`` values.

    Raises:
        ValueError: if the run has no such quantity.
    """
    live = run / _SCALARS / f"{name}.csv"
    if live.is_file():
        rows = np.loadtxt(live, delimiter=",", ndmin=2)
        return rows[:, 0], rows[:, 1]
    kept, column = run / ("validation.csv" if name in _VALIDATED else "curves.csv"), name.removeprefix("validation_")
    if kept.is_file():
        with kept.open(newline="") as file:
            table = [row for row in csv.DictReader(file) if row.get(column)]
        if table:
            return np.asarray([float(row["control_steps"]) for row in table]), np.asarray(
                [float(row[column]) for row in table]
            )
    raise ValueError(f"{run} has no {name}; expected a training run with --validate-every above 0.")


def time_to(run: Path, success: float) -> dict[str, float | None]:
    """When a validation first reached a success.

    Args:
        run: directory of the run.
        success: share of successful episodes [-].

    Returns:
        ``seconds`` and ``control_steps`` until then (None if it was never reached), the ``best`` validation, and the
        ``rate`` of the whole run [control steps/s].
    """
    steps, values = curve(run, "validation_success")
    at, seconds = curve(run, "seconds")
    reached = np.flatnonzero(values >= success)
    first = float(steps[reached[0]]) if len(reached) else None
    return {
        "seconds": None if first is None else float(np.interp(first, at, seconds, left=0.0)),
        "control_steps": first,
        "best": float(values.max()),
        "rate": float(at[-1] / seconds[-1]),
    }


def main(config: Config) -> None:
    """Print the time."""
    found = time_to(config.run, config.success)
    if config.json:
        print(json.dumps(found))
        return
    if found["seconds"] is None:
        print(f"a success of {config.success} was not reached; the best validation has {found['best']:.3f}")
    else:
        print(
            f"a success of {config.success} after {found['seconds']:.0f} s, {found['control_steps']:,.0f} control steps"
        )
    print(f"{found['rate']:,.0f} control steps/s")


if __name__ == "__main__":
    run_script(main, Config)
