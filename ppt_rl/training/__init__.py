"""Training and evaluation that every recipe shares."""

from ppt_rl.training.checkpoint import CheckpointMismatch, checkpoint_info, find_checkpoint, load_checkpoint
from ppt_rl.training.cli import run_cli
from ppt_rl.training.config import TaskConfig, episode_metrics, make_controller, prepare_torch
from ppt_rl.training.demonstrations import PUSH_AXES, fit_push_prior
from ppt_rl.training.evaluation import (
    POWER_AND_WORK,
    REPORTED,
    ZeroPolicy,
    distribution,
    record_episodes,
    run_episodes,
    summarise,
)
from ppt_rl.training.loop import train_ppo
from ppt_rl.training.maze import (
    MAZE_AXES,
    MAZE_PRIVILEGED,
    MazeConfig,
    RecedingConfig,
    StepWiseMazeConfig,
    make_maze_env,
    make_maze_policy,
    make_maze_promp,
    maze_metrics,
    maze_space,
)
from ppt_rl.training.maze_prior import fit_maze_prior, make_follower, make_follower_env
from ppt_rl.training.ppo import PPOConfig
from ppt_rl.training.pretrained import is_pretrained, load_pretrained, pretrained_card, save_pretrained
from ppt_rl.training.push import (
    PRIVILEGED,
    EpisodeLevelConfig,
    PushConfig,
    StepWiseConfig,
    make_push_env,
    make_push_policy,
)
from ppt_rl.training.recipe import as_json, make_actor_critic, run_recipe
from ppt_rl.training.wall_follower import WallFollower

__all__ = [
    "MAZE_AXES",
    "MAZE_PRIVILEGED",
    "POWER_AND_WORK",
    "PRIVILEGED",
    "PUSH_AXES",
    "REPORTED",
    "CheckpointMismatch",
    "EpisodeLevelConfig",
    "MazeConfig",
    "PPOConfig",
    "PushConfig",
    "RecedingConfig",
    "StepWiseConfig",
    "StepWiseMazeConfig",
    "TaskConfig",
    "WallFollower",
    "ZeroPolicy",
    "as_json",
    "checkpoint_info",
    "distribution",
    "episode_metrics",
    "find_checkpoint",
    "fit_maze_prior",
    "fit_push_prior",
    "is_pretrained",
    "load_checkpoint",
    "load_pretrained",
    "make_actor_critic",
    "make_controller",
    "make_follower",
    "make_follower_env",
    "make_maze_env",
    "make_maze_policy",
    "make_maze_promp",
    "make_push_env",
    "make_push_policy",
    "maze_metrics",
    "maze_space",
    "prepare_torch",
    "pretrained_card",
    "record_episodes",
    "run_cli",
    "run_episodes",
    "run_recipe",
    "save_pretrained",
    "summarise",
    "train_ppo",
]
