"""Box pushing as a learning task."""

from ppt_rl.tasks.push.config import (
    ByGoal,
    EpisodeLevelConfig,
    PushConfig,
    StepWiseConfig,
    make_push_env,
)
from ppt_rl.tasks.push.networks import PRIVILEGED, make_push_cost_critic, make_push_policy
from ppt_rl.tasks.push.prior import PUSH_AXES, fit_push_prior
from ppt_rl.tasks.push.step_wise import fit_step_wise, step_wise_modules, step_wise_transforms
from ppt_rl.tasks.push.task import PUSH

__all__ = [
    "PRIVILEGED",
    "PUSH",
    "PUSH_AXES",
    "ByGoal",
    "EpisodeLevelConfig",
    "PushConfig",
    "StepWiseConfig",
    "fit_push_prior",
    "fit_step_wise",
    "make_push_cost_critic",
    "make_push_env",
    "make_push_policy",
    "step_wise_modules",
    "step_wise_transforms",
]
