"""Maze sliding as a learning task."""

from ppt_rl.tasks.maze.config import (
    MAZE_AXES,
    MazeConfig,
    RecedingConfig,
    StepWiseMazeConfig,
    make_maze_promp,
    maze_metrics,
    maze_space,
    velocity_map,
)
from ppt_rl.tasks.maze.environments import make_test_env, make_training_env
from ppt_rl.tasks.maze.follower import WallFollower
from ppt_rl.tasks.maze.networks import MAZE_PRIVILEGED, make_maze_policy
from ppt_rl.tasks.maze.prior import fit_maze_prior, make_follower, make_follower_env
from ppt_rl.tasks.maze.task import MAZE

__all__ = [
    "MAZE",
    "MAZE_AXES",
    "MAZE_PRIVILEGED",
    "MazeConfig",
    "RecedingConfig",
    "StepWiseMazeConfig",
    "WallFollower",
    "fit_maze_prior",
    "make_follower",
    "make_follower_env",
    "make_maze_policy",
    "make_maze_promp",
    "make_test_env",
    "make_training_env",
    "maze_metrics",
    "maze_space",
    "velocity_map",
]
