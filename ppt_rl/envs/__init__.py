"""Simulated arms with joint torque as the action, and the physics side of each task."""

from ppt_rl.envs.arm import PandaEnv
from ppt_rl.envs.maze import (
    Disc,
    MazeLayout,
    MazeRandomisation,
    MazeRanges,
    MazeRewards,
    PandaMazeEnv,
    Straight,
    StraightRanges,
    Turn,
    paper_layout,
    random_maze,
    random_straight,
)
from ppt_rl.envs.push import PandaPushEnv, PushRandomisation, PushRewards

__all__ = [
    "Disc",
    "MazeLayout",
    "MazeRandomisation",
    "MazeRanges",
    "MazeRewards",
    "PandaEnv",
    "PandaMazeEnv",
    "PandaPushEnv",
    "PushRandomisation",
    "PushRewards",
    "Straight",
    "StraightRanges",
    "Turn",
    "paper_layout",
    "random_maze",
    "random_straight",
]
