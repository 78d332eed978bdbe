"""Simulated Panda environments."""

from ppt_rl.envs.panda import PandaEnv
from ppt_rl.envs.push import PandaPushEnv, PushRandomisation, PushRewards

__all__ = ["PandaEnv", "PandaPushEnv", "PushRandomisation", "PushRewards"]
