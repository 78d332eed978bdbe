"""Training and evaluation that every recipe shares."""

from ppt_rl.training.checkpoint import CheckpointMismatch, checkpoint_info, find_checkpoint, load_checkpoint
from ppt_rl.training.cli import run_cli
from ppt_rl.training.demonstrations import PUSH_AXES, fit_push_prior
from ppt_rl.training.evaluation import REPORTED, evaluate, run_episodes, summarise
from ppt_rl.training.ppo import PPOConfig, train_ppo
from ppt_rl.training.recipe import as_json, make_actor_critic, run_recipe

__all__ = [
    "PUSH_AXES",
    "REPORTED",
    "CheckpointMismatch",
    "PPOConfig",
    "as_json",
    "checkpoint_info",
    "evaluate",
    "find_checkpoint",
    "fit_push_prior",
    "load_checkpoint",
    "make_actor_critic",
    "run_cli",
    "run_episodes",
    "run_recipe",
    "summarise",
    "train_ppo",
]
