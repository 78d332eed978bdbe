"""Where a maze policy breaks: success against the size of turns, width, height and friction.

``python recipes/maze_difficulty.py CHECKPOINT --report results/maze``
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import torch
import tyro
from evaluate_maze import Config as Evaluation
from evaluate_maze import evaluate
from registry import load_policy

from ppt_rl.envs import MazeRanges
from ppt_rl.training import run_cli
from ppt_rl.training.evaluation import interval
from ppt_rl.training.logs import write_text_atomically
from ppt_rl.training.maze_plots import plot_difficulty

_USUAL = MazeRanges()


def _turn(degrees: float) -> MazeRanges:
    return replace(_USUAL, turn=(math.radians(degrees),) * 2, length=(0.8, 1.1))


def _width(millimetres: float) -> MazeRanges:
    return replace(_USUAL, width=(1e-3 * millimetres,) * 2)


def _rise(centimetres: float) -> MazeRanges:
    return replace(_USUAL, rise=(1e-2 * centimetres,) * 2)


def _friction(friction: float) -> MazeRanges:
    return replace(_USUAL, friction=(friction, friction))


#: Quantity to what makes mazes of it, the values that are tried, and the range of the test mazes.
SWEEPS: dict[str, tuple[Callable[[float], MazeRanges], Sequence[float], tuple[float, float]]] = {
    "turns [degrees]": (_turn, (0, 15, 30, 45, 60), (20, 45)),
    "width [mm]": (_width, (45, 50, 55, 60), (50, 60)),
    "rise [cm]": (_rise, (0, 2, 4, 6), (1, 4)),
    "friction [-]": (_friction, (0.1, 0.25, 0.4, 0.6, 0.8), (0.1, 0.4)),
}


@dataclass(frozen=True)
class Config:
    """Sweep the difficulty of the mazes, one quantity at a time; the others stay within the test's ranges.

    Attributes:
        checkpoints: policies: checkpoints, directories of runs, or published policies.
        mazes: for each value.
        seed: of the mazes.
        num_threads: physics threads; 0 takes one per CPU.
        baseline: sweep the wall follower too, with the first policy's impedance.
        report: write difficulty.json and difficulty.png into this directory.
    """

    checkpoints: Annotated[tuple[Path, ...], tyro.conf.Positional]
    mazes: int = 64
    seed: int = 30_000
    num_threads: int = 0
    baseline: bool = False
    report: Path = Path("runs/difficulty")


def main(run: Config) -> None:
    """Sweep and draw."""
    if not run.checkpoints:
        raise ValueError("no checkpoint given; expected at least one.")
    curves: dict[str, dict[str, Any]] = {}
    for quantity, (ranges, values, _) in SWEEPS.items():
        for value in values:
            for number, path in enumerate(run.checkpoints):
                policy = load_policy(path)
                if policy.task != "maze":
                    raise ValueError(f"{path} holds {policy.variant}; expected a maze policy.")
                setup = Evaluation(
                    path, mazes=run.mazes, seed=run.seed, num_threads=run.num_threads,
                    baseline=run.baseline and number == 0,
                )  # fmt: skip
                for name, rows in evaluate(policy, setup, ranges(value), baselines=["wall follower"]).items():
                    label = {"ppt_maze": "PPT", "st_maze": "ST"}.get(name, name)
                    entry = curves.setdefault(quantity, {}).setdefault(label, ([], [], []))
                    entry[0].append(value)
                    entry[1].append(float(rows["success"].mean()))
                    entry[2].append(interval(rows["success"], is_rate=True))
                    print(f"{quantity} {value:g}, {label}: success {entry[1][-1]:.2f}", flush=True)
        write_text_atomically(run.report / "difficulty.json", json.dumps(curves, indent=2) + "\n")
    plot_difficulty(curves, run.report / "difficulty.png", usual={name: sweep[2] for name, sweep in SWEEPS.items()})


if __name__ == "__main__":
    torch.set_num_threads(1)
    torch.manual_seed(0)
    run_cli(main, Config)
