"""Simulated Panda environments."""

from ppt_rl.envs.maze import PandaMazeEnv
from ppt_rl.envs.maze_episode import MazeRandomisation, MazeRewards
from ppt_rl.envs.models import (
    Disc,
    MazeLayout,
    MazeRanges,
    Straight,
    StraightRanges,
    Turn,
    paper_layout,
    random_maze,
    random_straight,
)
from ppt_rl.envs.panda import PandaEnv
from ppt_rl.envs.push import PandaPushEnv, PushRewards
from ppt_rl.envs.push_episode import PushRandomisation

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
