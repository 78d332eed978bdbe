"""What many entries need and what takes long to make: made once."""

from __future__ import annotations

from functools import cache

from ppt_rl.envs import PushEnv
from ppt_rl.evaluation import Policy, load_policy
from tests.engines import COARSE

__all__ = ["policy", "push_env"]


@cache
def push_env() -> PushEnv:
    """Two environments of the pushing task."""
    return PushEnv(2, duration=0.1, seed=0, engine=COARSE)


@cache
def policy(name: str = "ppt_push") -> Policy:
    """A published policy."""
    return load_policy(name)
