"""Maze sliding: layouts and their geometry, scene, episodes, rewards and environment."""

from ppt_rl.envs.maze.env import MazeEnv
from ppt_rl.envs.maze.layout import Disc, MazeLayout, Straight, Turn, paper_layout
from ppt_rl.envs.maze.rewards import MazeRewards
from ppt_rl.envs.maze.sampling import MazeRanges, StraightRanges, random_maze, random_straight
from ppt_rl.envs.maze.start import MazeRandomisation

__all__ = [
    "Disc",
    "MazeEnv",
    "MazeLayout",
    "MazeRandomisation",
    "MazeRanges",
    "MazeRewards",
    "Straight",
    "StraightRanges",
    "Turn",
    "paper_layout",
    "random_maze",
    "random_straight",
]
