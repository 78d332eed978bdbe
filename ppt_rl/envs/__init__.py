"""Simulated arms with joint torque as the action, and the physics side of each task."""

from ppt_rl.envs.arm import ArmEnv
from ppt_rl.envs.maze import (
    Disc,
    MazeEnv,
    MazeLayout,
    MazeRandomisation,
    MazeRanges,
    MazeRewards,
    Straight,
    StraightRanges,
    Turn,
    paper_layout,
    random_maze,
    random_straight,
)
from ppt_rl.envs.panda import PandaEnv, PandaMazeEnv, PandaPushEnv
from ppt_rl.envs.physics import EngineConfig
from ppt_rl.envs.push import PushEnv, PushGoal, PushRandomisation, PushReference, PushRewards

__all__ = [
    "ArmEnv",
    "Disc",
    "EngineConfig",
    "MazeEnv",
    "MazeLayout",
    "MazeRandomisation",
    "MazeRanges",
    "MazeRewards",
    "PandaEnv",
    "PandaMazeEnv",
    "PandaPushEnv",
    "PushEnv",
    "PushGoal",
    "PushRandomisation",
    "PushReference",
    "PushRewards",
    "Straight",
    "StraightRanges",
    "Turn",
    "paper_layout",
    "random_maze",
    "random_straight",
]
