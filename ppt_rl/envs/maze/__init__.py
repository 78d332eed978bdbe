"""Maze sliding: layouts and their geometry, scene, episodes, rewards and environment."""

from ppt_rl.envs.maze.env import PandaMazeEnv
from ppt_rl.envs.maze.episode import MazeRandomisation
from ppt_rl.envs.maze.layout import Disc, MazeLayout, Straight, Turn, paper_layout
from ppt_rl.envs.maze.rewards import MazeRewards
from ppt_rl.envs.maze.sampling import MazeRanges, StraightRanges, random_maze, random_straight

__all__ = [
    "Disc",
    "MazeLayout",
    "MazeRandomisation",
    "MazeRanges",
    "MazeRewards",
    "PandaMazeEnv",
    "Straight",
    "StraightRanges",
    "Turn",
    "paper_layout",
    "random_maze",
    "random_straight",
]
