"""Simulated Panda environments."""

from ppt_rl.envs.panda import PandaEnv
from ppt_rl.envs.push import PandaPushEnv, PushRewards
from ppt_rl.envs.push_episode import PushRandomisation

__all__ = ["PandaEnv", "PandaPushEnv", "PushRandomisation", "PushRewards"]
