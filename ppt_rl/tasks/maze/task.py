"""Maze sliding as the evaluation and the studies see it."""

from __future__ import annotations

from typing import Any

from torchrl.envs import EnvBase

from ppt_rl.envs import ArmEnv, paper_layout
from ppt_rl.evaluation import COLUMNS, Column, Pictures, Policy, Report, SecondPass, Task
from ppt_rl.tasks.maze.difficulty import MAZE_SWEEP
from ppt_rl.tasks.maze.environments import make_test_env, make_training_env
from ppt_rl.tasks.maze.figures import draw_maze_episode
from ppt_rl.tasks.maze.networks import MAZE_PRIVILEGED
from ppt_rl.tasks.maze.prior import make_follower, make_follower_env
from ppt_rl.tasks.maze.study_figures import draw_maze_study

__all__ = ["MAZE"]

#: A second low-pass, for the metric of jerk alone [Hz]: the paper names none, and jerk depends on it.
_SLOW_CUTOFF = 5.0
_NOTE = (
    "Velocity and force go through a second-order Butterworth low-pass at 10 Hz, for jerk_rms_slow at "
    f"{_SLOW_CUTOFF:g} Hz. The paper's figures are of a real robot in one printed maze, without a word on its "
    "filter; ours are of a simulation."
)
#: The paper's table of the real robot; shares where it has percentages.
_PAPER = {
    metric: {"PPT": ppt, "ST": st}
    for metric, ppt, st in (
        ("success", 0.89, 0.60),
        ("jerk_rms", 1.85, 2.70),
        ("jerk_rms_slow", 1.85, 2.70),
        ("wrench_p95", 8.5, 11.2),
        ("overload_ratio", 0.023, 0.031),
        ("contact_continuity", 0.74, 0.48),
        ("progress", 0.70, 0.76),
    )
}


def _wall_follower(policy: Policy, base: ArmEnv) -> tuple[EnvBase, Any]:
    """The hand-written follower, with the options of the policy."""
    return make_follower_env(policy.config, base), make_follower(policy.config)


MAZE = Task(
    name="maze",
    make_training_env=make_training_env,
    make_test_env=make_test_env,
    privileged=MAZE_PRIVILEGED,
    baselines={"wall follower": _wall_follower},
    report=Report(
        columns={
            **COLUMNS,
            "seconds": Column("s"),
            "left_corridor": Column("0-1", is_rate=True),
            "unsafe": Column("0-1", is_rate=True),
            "jerk_rms_slow": Column("m/s^3"),
        },
        episode_keys=("left_corridor", "unsafe"),
        second_passes={"jerk_rms_slow": SecondPass("jerk_rms", {"cutoff": _SLOW_CUTOFF})},
        paper=_PAPER,
        compared=("success", "jerk_rms", "jerk_rms_slow", "wrench_p95", "contact_continuity", "seconds"),
        boxes={"jerk_rms": "jerk RMS [m/s³]", "wrench_p95": "P95 force [N]", "seconds": "time [s]"},
        note=_NOTE,
    ),
    pictures=Pictures(
        every=10,
        speed=2.0,
        draw_episode=draw_maze_episode,
        draw_study=draw_maze_study,
        rollouts=8,
        given=lambda: [paper_layout()],
    ),
    sweep=MAZE_SWEEP,
)
