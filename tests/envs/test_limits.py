"""A slip of the keyboard in an argument of an environment is one clear error, at once."""

from __future__ import annotations

import math
import time

import pytest

from ppt_rl.envs import (
    ArmEnv,
    Disc,
    EngineConfig,
    MazeEnv,
    MazeLayout,
    MazeRandomisation,
    MazeRanges,
    PushEnv,
    PushRandomisation,
    Straight,
    StraightRanges,
    Turn,
)

INF, NAN = math.inf, math.nan
SLIPS = {
    "time step of a nanosecond": (lambda: EngineConfig(physics_dt=1e-9), "physics_dt is 1e-09; expected a number from"),
    "time step of a second": (lambda: EngineConfig(physics_dt=1.0), "physics_dt is 1.0; expected a number from 1e-05"),
    "a billion threads": (lambda: EngineConfig(num_threads=10**9), "num_threads is 1000000000; expected at most 1024"),
    "half a thread": (lambda: EngineConfig(num_threads=1.5), "num_threads is 1.5; expected a whole number"),
    "a billion environments": (lambda: ArmEnv(10**9), "num_envs is 1000000000; expected at most 16384"),
    "endless environments": (lambda: ArmEnv(INF), "num_envs is inf; expected a whole number"),
    "no number of environments": (lambda: ArmEnv(NAN), "num_envs is nan; expected a whole number"),
    "an episode of thirty years": (
        lambda: ArmEnv(duration=1e9),
        "duration is 1000000000.0; expected a number from 0 to",
    ),
    "an endless episode": (lambda: ArmEnv(duration=INF), "duration is inf; expected a finite number"),
    "no control step": (lambda: ArmEnv(control_dt=NAN), "control_dt is nan; expected a finite number"),
    "an endless control step": (lambda: ArmEnv(control_dt=INF), "control_dt is inf; expected a finite number"),
    "a control step of a day": (lambda: ArmEnv(control_dt=86400.0), "control_dt is 86400.0; expected a number from"),
    "substeps without end": (
        lambda: ArmEnv(control_dt=1.0, engine=EngineConfig(physics_dt=1e-5)),
        "100000 times .*; expected at most 2000",
    ),
    "a box of a kilometre": (
        lambda: PushEnv(box_sizes=(1e3,)),
        "an entry of box_sizes is 1000.0; expected a number from",
    ),
    "a box of no size": (
        lambda: PushEnv(box_sizes=(NAN,)),
        "an entry of box_sizes is nan; expected a number from 0.03",
    ),
    "a negative box": (
        lambda: PushEnv(box_sizes=(-0.06,)),
        "an entry of box_sizes is -0.06; expected a number from 0.03",
    ),
    "no box": (lambda: PushEnv(box_sizes=()), "box_sizes is empty; expected one edge length or more"),
    "a box without a mass": (
        lambda: PushEnv(box_sizes=(0.06,), box_masses=(0.0,)),
        "an entry of box_masses is 0.0; expected a number from 0.01",
    ),
    "a box that no arm moves": (
        lambda: PushEnv(box_sizes=(0.06,), box_masses=(INF,)),
        "an entry of box_masses is inf; expected a number from",
    ),
    "a mass too many": (
        lambda: PushEnv(box_sizes=(0.1,), box_masses=(0.1, 0.2)),
        r"box_masses are \(0.1, 0.2\); expected 1, one for each",
    ),
    "a box around the tool": (
        lambda: PushEnv(box_sizes=(0.2,), box_masses=(0.2,)),
        "a box of 0.2 m may begin inside the tool: randomisation.box_x begins at 0.43 m; expected at least 0.488 m",
    ),
    "success anywhere": (
        lambda: PushEnv(success_radius=INF),
        "success_radius is inf; expected a distance above 0 m, at most 1 m",
    ),
    "friction without end": (
        lambda: PushRandomisation(friction=(0.2, INF)),
        r"PushRandomisation.friction is \(0.2, inf\); expected a pair",
    ),
    "a goal on the moon": (lambda: PushRandomisation(goal_x=(0.6, 4e8)), "PushRandomisation.goal_x .* from -2 to 2 m"),
    "a goal nowhere": (
        lambda: PushRandomisation(goal_x=(0.6, NAN)),
        "PushRandomisation.goal_x is .*; expected low <= high",
    ),
    "a start nowhere": (
        lambda: MazeRandomisation(along=(NAN, NAN)),
        "MazeRandomisation.along is .*; expected low <= high",
    ),
    "a start far away": (
        lambda: MazeRandomisation(along=(0.03, INF)),
        r"MazeRandomisation.along is \(.*inf\); expected",
    ),
    "a corridor without end": (
        lambda: StraightRanges(length=(0.2, INF)),
        r"StraightRanges.length is \(.*inf\); expected",
    ),
    "a corridor nowhere": (lambda: StraightRanges(x=(-INF, 0.5)), r"StraightRanges.x is \(-inf.*\); expected"),
    "a maze without end": (lambda: MazeRanges(length=(0.9, INF)), r"MazeRanges.length is \(.*inf\); expected"),
    "no maze": (lambda: MazeRanges(width=(NAN, 0.06)), "MazeRanges.width is .*; expected low <= high"),
    "a billion turns": (lambda: MazeRanges(turns=(3, 10**9)), "MazeRanges.turns .* is 1000000000; expected .* to 20"),
    "half a disc": (lambda: MazeRanges(discs=(0.5, 1.5)), r"MazeRanges.discs is \(0.5, 1.5\); expected whole numbers"),
    "a million segments": (
        lambda: MazeLayout((Straight(0.1), Turn(0.1)) * 500_000 + (Straight(0.1),)),
        "has 1000001 segments; expected at",
    ),
    "a straight of a kilometre": (lambda: Straight(1e3), "Straight.length is 1000.0; expected a number from"),
    "a disc without size": (lambda: Disc(NAN), "Disc.diameter is nan; expected a number from"),
    "a maze on the moon": (
        lambda: MazeLayout((Straight(0.2),), start=(1e8, 0.0)),
        "coordinate of start is 100000000.0",
    ),
    "a billion mazes": (
        lambda: MazeEnv.of([MazeLayout((Straight(0.2),))], 10**9),
        "num_envs is 1000000000; expected at",
    ),
}


@pytest.mark.parametrize("slip", SLIPS)
def test_a_slip_is_one_clear_error_at_once(slip):
    make, message = SLIPS[slip]
    started = time.perf_counter()
    with pytest.raises(ValueError, match=message):
        make()
    assert time.perf_counter() - started < 1.0


def test_ranges_within_which_no_maze_fits_are_refused_within_seconds():
    started = time.perf_counter()
    with pytest.raises(ValueError, match="none of 2000 layouts within MazeRanges"):
        MazeEnv.mazes(1, ranges=MazeRanges(length=(1.9, 2.0)), engine=EngineConfig(num_threads=1)).reset()
    assert time.perf_counter() - started < 20.0


def test_the_widest_values_are_accepted():
    EngineConfig(physics_dt=1e-5, num_threads=1024)
    PushRandomisation(box_yaw=(-math.pi, math.pi), friction=(0.0, 5.0))
    MazeLayout((Straight(2.0, 0.1),), start=(-10.0, 10.0))
    env = ArmEnv(1, duration=3600.0, control_dt=0.01, engine=EngineConfig(physics_dt=0.01, num_threads=1))
    assert env.horizon == 360_000
