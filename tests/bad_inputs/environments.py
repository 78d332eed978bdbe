"""Bad arguments of environments, of the physics behind them, and of what is drawn at random."""

from __future__ import annotations

import math

import numpy as np
import torch

from ppt_rl.arms import UR5E
from ppt_rl.envs import (
    ArmEnv,
    EngineConfig,
    MazeEnv,
    MazeRanges,
    MazeRewards,
    PandaEnv,
    PushEnv,
    PushRandomisation,
    PushRewards,
    StraightRanges,
    random_maze,
    random_straight,
)
from ppt_rl.envs.maze.start import MazeRandomisation
from ppt_rl.envs.models import Tool
from ppt_rl.envs.push import WALL, Obstacle, ObstructedPushEnv, Plate
from tests.bad_inputs.entry import bad, each

__all__ = ["ENTRIES"]

_POSITIVE, _WHOLE = "{name} is {value}; expected a finite number above 0", "{name} is {value}; expected a whole number"
_MEANT = "{name}.*{value}.*; expected"
_PAIR = "expected (a pair .low, high. of finite numbers|low <= high)"

_ENGINE = [
    *each(EngineConfig, "physics_dt", (0.0, -0.001, math.nan, math.inf, "fast", None), _POSITIVE),
    *each(EngineConfig, "num_threads", (0, -2), _MEANT),
    *each(EngineConfig, "num_threads", (1.5, "all", math.nan, 10**9), _MEANT),
    bad(EngineConfig, "audit.*yes.*; expected", audit="yes"),
    bad(Tool, "length.*-0.1.*; expected", -0.1, 0.01),
    bad(Tool, "stem_radius.*nan.*; expected", 0.1, math.nan),
    bad(Tool, "bar.*; expected", 0.1, 0.01, bar=(0.1, 0.1)),
]
_ARMS = [
    *each(ArmEnv, "num_envs", (0, -1, 2.5, True), _WHOLE),
    *each(ArmEnv, "num_envs", ("two", None, math.nan, [4], 10**9), _MEANT),
    *each(ArmEnv, "control_dt", (0.0, -0.01, math.nan, "fast"), _POSITIVE),
    bad(ArmEnv, "control_dt=0.0007 s is 1.4 times physics_dt=0.0005 s; expected a whole number. Set", control_dt=7e-4),
    *each(ArmEnv, "duration", (0.0, -3.0, math.nan, math.inf, "long"), _POSITIVE),
    bad(ArmEnv, "arm.*'panda'.*; expected", arm="panda"),
    bad(ArmEnv, "arm.*None.*; expected", arm=None),
    *each(ArmEnv, "seed", (-1, 1.5, "lucky"), _MEANT),
    bad(ArmEnv, "dtype.*int64.*; expected", dtype=torch.int64),
    bad(ArmEnv, "device.*tpu9.*; expected", device="tpu9"),
    bad(ArmEnv, "engine.*0.001.*; expected", engine=0.001),
    bad(ArmEnv, "engine.*; expected", engine="gpu"),
    bad(ArmEnv, "device.*GPUs here; expected", device="cuda:9"),
    bad(EngineConfig, "engine.*; expected", name="mujoco"),
    bad(EngineConfig, "contacts.*; expected", contacts=0),
    bad(PandaEnv, "arm is 'ur5e', but PandaEnv is the Panda's environment. Use", arm=UR5E),
]
_PUSH = [
    bad(PushEnv, r"box_sizes has \[0.07\] without .*; expected sizes among \[0.06, 0.08\] m", box_sizes=(0.07,)),
    bad(PushEnv, "box_sizes is empty; expected one edge length", box_sizes=()),
    bad(PushEnv, "box_sizes is nan; expected a number from", box_sizes=(math.nan,)),
    bad(PushEnv, "box_sizes.*0.06.*; expected", box_sizes=0.06),
    bad(PushEnv, "box_sizes.*; expected", box_sizes="0.06"),
    *each(PushEnv, "success_radius", (0.0, math.nan, -0.02), _MEANT),
    *each(PushEnv, "success_radius", (math.inf, "near", None), _MEANT),
    bad(PushEnv, "randomisation.*; expected", randomisation={"mass": (1.0, 1.0)}),
    bad(PushEnv, "rewards.*; expected", rewards=PushRandomisation()),
    bad(PushRandomisation, rf"PushRandomisation.mass is \(1.2, 0.8\); {_PAIR}", mass=(1.2, 0.8)),
    bad(PushRandomisation, rf"PushRandomisation.mass is \(nan, 1.0\); {_PAIR}", mass=(math.nan, 1.0)),
    bad(PushRandomisation, rf"PushRandomisation.box_x is \(0.4, inf\); {_PAIR}", box_x=(0.4, math.inf)),
    bad(PushRandomisation, rf"PushRandomisation.box_x is 0.45; {_PAIR}", box_x=0.45),
    bad(PushRandomisation, rf"PushRandomisation.goal_x is \(0.6,\); {_PAIR}", goal_x=(0.6,)),
    bad(PushRandomisation, rf"PushRandomisation.goal_y is \('left', 'right'\); {_PAIR}", goal_y=("left", "right")),
    bad(PushRandomisation, r"friction.*\(-0.5, -0.1\).*; expected", friction=(-0.5, -0.1)),
    bad(PushRandomisation, r"mass.*\(-1.0, 0.0\).*; expected", mass=(-1.0, 0.0)),
    *each(PushRewards, "progress", (math.nan, "high", None), _MEANT),
    *each(PushRewards, "force_limit", (-1.0, math.inf), _MEANT),
]
_RNG = np.random.default_rng(0)
_MAZES = [
    bad(MazeEnv.of, "layouts is empty; expected at least one MazeLayout", []),
    bad(MazeEnv.of, "layout.*'maze.json'.*; expected", ["maze.json"]),
    bad(MazeEnv, "source.*; expected", 1, "random"),
    *each(MazeEnv.straight, "max_force", (0.0, -40.0, math.nan), _MEANT),
    *each(MazeEnv.straight, "max_force", ("soft", None), _MEANT),
    bad(MazeEnv.straight, "ranges.*; expected", ranges=MazeRanges()),
    bad(MazeEnv.mazes, "ranges.*; expected", ranges={"width": (0.05, 0.06)}),
    bad(StraightRanges, rf"StraightRanges.width is \(0.06, 0.05\); {_PAIR}", width=(0.06, 0.05)),
    bad(StraightRanges, rf"StraightRanges.x is None; {_PAIR}", x=None),
    bad(StraightRanges, rf"StraightRanges.length is \(0.2, inf\); {_PAIR}", length=(0.2, math.inf)),
    bad(MazeRanges, rf"MazeRanges.friction is \(0.4, 0.1\); {_PAIR}", friction=(0.4, 0.1)),
    bad(MazeRanges, rf"MazeRanges.turn is \(nan, 0.5\); {_PAIR}", turn=(math.nan, 0.5)),
    bad(MazeRanges, r"turns.*\(1.5, 2.5\).*; expected", turns=(1.5, 2.5)),
    bad(MazeRanges, r"turns.*\(-3, -1\).*; expected", turns=(-3, -1)),
    bad(MazeRanges, r"discs.*1000000000.*; expected", discs=(0, 10**9)),
    bad(MazeRandomisation, rf"MazeRandomisation.along is \(0.04, 0.03\); {_PAIR}", along=(0.04, 0.03)),
    bad(MazeRandomisation, "puts the tool into a wall; expected along >= 0.02 m", along=(0.0, 0.01)),
    bad(MazeRandomisation, "puts the tool into a wall; expected .* across within", across=(-1.0, 1.0)),
    bad(random_maze, "none of 2000 layouts within .* fits .*; widen", _RNG, MazeRanges(length=(0.1, 0.1))),
    bad(random_straight, "none of 2000 layouts within .* fits .*; widen", _RNG, StraightRanges(x=(1.9, 1.9))),
    bad(MazeRanges, r"turns.*1000000.*; expected", turns=(10**6, 10**6)),
    bad(random_maze, "rng.*42.*; expected", 42),
    bad(random_maze, "arm.*'panda'.*; expected", _RNG, arm="panda"),
    *each(MazeRewards, "cruise", (0.0, math.nan, "slow"), _MEANT),
    *each(MazeRewards, "force_scale", (0.0, math.inf), _MEANT),
]

_OBSTACLES = [
    bad(Plate, "Plate.half_size.*; expected", (0.01, 0.1), 1e5),
    bad(Plate, "a side of Plate.half_size is -0.1; expected", (0.01, -0.1, 0.1), 1e5),
    bad(Plate, "Plate.stiffness is 1000000.0; expected", (0.01, 0.1, 0.1), 1e6),
    bad(Plate, "Plate.stiffness is nan; expected", (0.01, 0.1, 0.1), math.nan),
    bad(Plate, "Plate.mass is 0.0; expected", (0.01, 0.1, 0.1), 1e5, 0.0),
    bad(Obstacle, r"Obstacle.plates is \(\); expected a tuple of at least 1", ()),
    bad(Obstacle, "Obstacle.plates is .*; expected a tuple of at least 2", (WALL,), hold=(0.1, 0.2)),
    bad(Obstacle, "an entry of Obstacle.plates is .*; expected", ("wall",)),
    bad(Obstacle, "Obstacle.place is 'floor'; expected one of", (WALL,), place="floor"),
    bad(Obstacle, "Obstacle.along is 2; expected", (WALL,), along=2),
    bad(Obstacle, "Obstacle.gap is -0.1; expected", (WALL,), gap=-0.1),
    bad(Obstacle, "Obstacle.jump is inf; expected", (WALL,), jump=math.inf),
    bad(Obstacle, r"Obstacle.clamped is \(\); expected", (WALL,), clamped=()),
    bad(Obstacle, "Obstacle.hold is .*; expected 0 <= low <= high", (WALL, WALL), hold=(0.2, 0.1)),
    bad(ObstructedPushEnv, "obstacle is .*; expected", obstacle="wall"),
    bad(
        ObstructedPushEnv, "physics_dt is 0.001 s; expected at most 0.0005 s", obstacle=Obstacle((WALL,)),
        engine=EngineConfig(physics_dt=0.001),
    ),
]  # fmt: skip

ENTRIES = [*_OBSTACLES, *_ENGINE, *_ARMS, *_PUSH, *_MAZES]
