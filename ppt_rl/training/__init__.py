"""Training and evaluation that every recipe shares."""

from ppt_rl.training.checkpoint import CheckpointMismatch, checkpoint_info, find_checkpoint, load_checkpoint
from ppt_rl.training.cli import run_cli
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
from ppt_rl.training.ppo import PPOConfig
from ppt_rl.training.pretrained import is_pretrained, load_pretrained, pretrained_card, save_pretrained
from ppt_rl.training.push import (
    PRIVILEGED,
    EpisodeLevelConfig,
    PushConfig,
    StepWiseConfig,
    make_push_controller,
    make_push_env,
    make_push_policy,
    prepare_torch,
    push_metrics,
)
from ppt_rl.training.recipe import as_json, make_actor_critic, run_recipe

__all__ = [
    "POWER_AND_WORK",
    "PRIVILEGED",
    "PUSH_AXES",
    "REPORTED",
    "CheckpointMismatch",
    "EpisodeLevelConfig",
    "PPOConfig",
    "PushConfig",
    "StepWiseConfig",
    "ZeroPolicy",
    "as_json",
    "checkpoint_info",
    "distribution",
    "find_checkpoint",
    "fit_push_prior",
    "is_pretrained",
    "load_checkpoint",
    "load_pretrained",
    "make_actor_critic",
    "make_push_controller",
    "make_push_env",
    "make_push_policy",
    "prepare_torch",
    "pretrained_card",
    "push_metrics",
    "record_episodes",
    "run_cli",
    "run_episodes",
    "run_recipe",
    "save_pretrained",
    "summarise",
    "train_ppo",
]
