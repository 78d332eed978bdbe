"""Box pushing as a learning task."""

from ppt_rl.tasks.push.config import (
    PRIVILEGED,
    EpisodeLevelConfig,
    PushConfig,
    StepWiseConfig,
    make_push_env,
    make_push_policy,
)
from ppt_rl.tasks.push.prior import PUSH_AXES, fit_push_prior

__all__ = [
    "PRIVILEGED",
    "PUSH_AXES",
    "EpisodeLevelConfig",
    "PushConfig",
    "StepWiseConfig",
    "fit_push_prior",
    "make_push_env",
    "make_push_policy",
]
