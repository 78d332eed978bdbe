"""The PPO loop, its checkpoints and its logs; no word of a task."""

from ppt_rl.training.checkpoint import CheckpointMismatch, checkpoint_info, find_checkpoint, load_checkpoint
from ppt_rl.training.loop import train_ppo
from ppt_rl.training.ppo import PPOConfig
from ppt_rl.training.recipe import as_json, make_actor_critic, run_recipe
from ppt_rl.training.script import run_cli

__all__ = [
    "CheckpointMismatch",
    "PPOConfig",
    "as_json",
    "checkpoint_info",
    "find_checkpoint",
    "load_checkpoint",
    "make_actor_critic",
    "run_cli",
    "run_recipe",
    "train_ppo",
]
