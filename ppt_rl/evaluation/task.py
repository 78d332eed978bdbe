"""What the library asks of a task, so that one evaluation and one study serve every task."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from ppt_rl.envs import ArmEnv
from ppt_rl.evaluation.columns import COLUMNS, Column
from ppt_rl.evaluation.difficulty import Sweep
from ppt_rl.evaluation.make_env import MakeEnv
from ppt_rl.evaluation.scenario import Scenario
from ppt_rl.evaluation.statistics import Claim

__all__ = ["Baseline", "Pictures", "Report", "SecondPass", "Task"]


#: From a policy (for its options) and a bare test environment: the environment that a baseline acts on, and the
#: baseline itself.
Baseline = Callable[[Any, ArmEnv], tuple[EnvBase, Any]]


@dataclass(frozen=True)
class SecondPass:
    """A metric that needs the same episodes again under other options, such as another filter.

    Attributes:
        metric: metric to take from the second pass.
        changes: options of that pass by name.
    """

    metric: str
    changes: Mapping[str, Any]


@dataclass(frozen=True)
class Report:
    """How a task's results are tabulated.

    Attributes:
        columns: metrics of the tables in order.
        episode_keys: further observations at the end of an episode to keep for each: scalars ``(*B, 1)``.
        second_passes: metrics from a second pass over the same episodes, by the name of their column.
        paper: figures of the paper to print beside: by metric, by label of the variant.
        claims: orderings to test over seeds.
        compared: metrics to compare episode by episode with the first variant.
        boxes: metrics drawn as box plots, with the labels of their axes.
        note: what a reader of the tables must know besides.
    """

    columns: Mapping[str, Column] = field(default_factory=lambda: COLUMNS)
    episode_keys: tuple[str, ...] = ()
    second_passes: Mapping[str, SecondPass] = field(default_factory=dict)
    paper: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    claims: tuple[Claim, ...] = ()
    compared: tuple[str, ...] = ("success", "jerk_rms", "wrench_p95")
    boxes: Mapping[str, str] = field(
        default_factory=lambda: {"jerk_rms": "jerk RMS [m/s³]", "wrench_p95": "P95 force [N]"}
    )
    note: str = ""


@dataclass(frozen=True)
class Pictures:
    """What of a task is recorded, filmed and drawn.

    Attributes:
        configuration: observations that together are MuJoCo's generalised positions, in order.
        trace: further observations to record at every control step.
        every: control steps between two frames of a video.
        speed: of the video, relative to real time.
        cameras: cameras of the video, side by side.
        draw_episode: draws one recorded episode: called with the policy, the bare environment, the episode (without a
            batch dimension; it is that of the first environment) and the path of the picture.
        draw_study: draws the figures that only this task has: called with the runs by label and the directory.
        rollouts: number of episodes that a study records of a run.
        given: makes the episodes to record, in the task's own form; none takes random ones.
    """

    configuration: tuple[str, ...] = ("joint_position",)
    trace: tuple[str, ...] = ("pose", "twist", "wrench", "power")
    every: int = 4
    speed: float = 1.0
    cameras: tuple[str, ...] = ("overview", "top")
    draw_episode: Callable[[Any, Any, TensorDictBase, Path], None] | None = None
    draw_study: Callable[[Mapping[str, Sequence[Any]], Path], None] | None = None
    rollouts: int = 4
    given: Callable[[], Sequence[Any]] = tuple


def _no_groups(config: Any) -> dict[str, dict[str, Any]]:
    return {}


@dataclass(frozen=True)
class Task:
    """A task as training, evaluation and studies see it.

    Attributes:
        name: name of the task, the last part of its variants' names.
        make_training_env: makes the environment to train in.
        make_test_env: makes the environment to be judged in.
        privileged: observations that exist in simulation only; an evaluated policy never sees them.
        groups: from options, groups of episodes that get rows of their own, by label: the options that make them.
        baselines: who else acts, by label; the reference alone comes by itself for variants that have one.
        references: baselines that only variants with a reference have: other references, by label.
        report: how results are tabulated.
        pictures: what is recorded, filmed and drawn.
        scenarios: what may go wrong in its episodes, for the collision benchmark.
        make_movable_env: makes the environment of the test with an obstacle that the live view moves: it has
            ``obstacle_place`` (x, y) [m] and ``move_obstacle(place)``. None where there is none.
        sweep: difficulty of the episodes, one quantity at a time; None where there is none.
    """

    name: str
    make_training_env: MakeEnv
    make_test_env: MakeEnv
    privileged: tuple[str, ...] = ()
    groups: Callable[[Any], Mapping[str, Mapping[str, Any]]] = _no_groups
    baselines: Mapping[str, Baseline] = field(default_factory=dict)
    references: Mapping[str, Baseline] = field(default_factory=dict)
    report: Report = field(default_factory=Report)
    pictures: Pictures = field(default_factory=Pictures)
    scenarios: tuple[Scenario, ...] = ()
    make_movable_env: MakeEnv | None = None
    sweep: Sweep | None = None
