"""The PPO loop, its checkpoints and its logs; it knows no task."""

from ppt_rl.training.checkpoint import CheckpointMismatch, checkpoint_info, find_checkpoint, load_checkpoint
from ppt_rl.training.config import RunConfig, as_json, from_json, prepare_torch, preset_options, with_settings
from ppt_rl.training.constrained import ConstrainedLearner
from ppt_rl.training.finite import TrainingDiverged
from ppt_rl.training.lagrangian import Constraint, LagrangianPPOLoss
from ppt_rl.training.loop import train_ppo
from ppt_rl.training.networks import begin_norms, make_actor_critic, make_cost_critic
from ppt_rl.training.ppo import Learner, PPOConfig
from ppt_rl.training.progress import TrainingRun
from ppt_rl.training.resume import options_to_resume
from ppt_rl.training.run import Learners, train_in_run_dir
from ppt_rl.training.script import run_script
from ppt_rl.training.validation import VALIDATED, Validation

__all__ = [
    "VALIDATED",
    "CheckpointMismatch",
    "ConstrainedLearner",
    "Constraint",
    "LagrangianPPOLoss",
    "Learner",
    "Learners",
    "PPOConfig",
    "RunConfig",
    "TrainingDiverged",
    "TrainingRun",
    "Validation",
    "as_json",
    "begin_norms",
    "checkpoint_info",
    "find_checkpoint",
    "from_json",
    "load_checkpoint",
    "make_actor_critic",
    "make_cost_critic",
    "options_to_resume",
    "prepare_torch",
    "preset_options",
    "run_script",
    "train_in_run_dir",
    "train_ppo",
    "with_settings",
]
