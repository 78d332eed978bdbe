"""Where a maze policy breaks: success against the size of turns, width, height and friction.

``python recipes/maze_difficulty.py CHECKPOINT --report results/maze``
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
import tyro
from registry import load_policy

from ppt_rl.envs import MazeLayout, MazeRanges, random_maze
from ppt_rl.evaluation import run_episodes
from ppt_rl.evaluation.episodes import interval
from ppt_rl.tasks.maze import make_follower, make_follower_env, make_maze_env
from ppt_rl.tasks.maze.figures import plot_difficulty
from ppt_rl.training import run_cli
from ppt_rl.training.logs import write_text_atomically

_USUAL = MazeRanges()
#: Mazes that are driven through together.
_TOGETHER = 96


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
    "turns [degrees]": (_turn, (0, 15, 30, 45, 60, 75), (20, 45)),
    "width [mm]": (_width, (30, 35, 40, 45, 50, 55, 60), (50, 60)),
    "rise [cm]": (_rise, (0, 2, 4, 6, 8, 10), (1, 4)),
    "friction [-]": (_friction, (0.1, 0.25, 0.4, 0.6, 0.8, 1.0), (0.1, 0.4)),
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
    points = _points(run)
    layouts = [layout for _, _, drawn in points for layout in drawn]
    curves: dict[str, dict[str, Any]] = {}
    for label, make_env, actor in _actors(run):
        env = make_env(num_envs=min(_TOGETHER, len(layouts)), seed=run.seed, layouts=layouts)
        success = run_episodes(env, actor, len(layouts))["success"].reshape(len(points), run.mazes)
        env.close()
        for (quantity, value, _), here in zip(points, success, strict=True):
            entry = curves.setdefault(quantity, {}).setdefault(label, ([], [], []))
            entry[0].append(value)
            entry[1].append(float(here.mean()))
            entry[2].append(interval(here, is_rate=True))
            print(f"{quantity} {value:g}, {label}: success {entry[1][-1]:.2f}", flush=True)
        write_text_atomically(run.report / "difficulty.json", json.dumps(curves, indent=2) + "\n")
    plot_difficulty(curves, run.report / "difficulty.png", usual={name: sweep[2] for name, sweep in SWEEPS.items()})


def _points(run: Config) -> list[tuple[str, float, list[MazeLayout]]]:
    """Quantity, value and mazes of every point of the curves; the n-th maze of all values is drawn from one seed."""
    return [
        (name, value, [random_maze(np.random.default_rng([run.seed, n]), ranges(value)) for n in range(run.mazes)])
        for name, (ranges, values, _) in SWEEPS.items()
        for value in values
    ]


def _actors(run: Config) -> Iterator[tuple[str, Callable[..., Any], Any]]:
    """Label, maker of the environment, and who acts."""
    policies = [load_policy(path).with_changes({"num_threads": run.num_threads}) for path in run.checkpoints]
    for path, policy in zip(run.checkpoints, policies, strict=True):
        if policy.task != "maze":
            raise ValueError(f"{path} holds {policy.variant}; expected a maze policy.")
    variants = [policy.variant for policy in policies]
    for path, policy in zip(run.checkpoints, policies, strict=True):
        name = {"ppt_maze": "PPT", "st_maze": "ST"}[policy.variant]
        yield name if variants.count(policy.variant) == 1 else f"{name}, {path}", policy.make_env, policy.actor
    if run.baseline:
        config = policies[0].config

        def make_env(**where: Any) -> Any:
            return make_follower_env(config, make_maze_env(config, **where))

        yield "wall follower", make_env, make_follower(config)


if __name__ == "__main__":
    torch.set_num_threads(1)
    torch.manual_seed(0)
    run_cli(main, Config)
