"""Box pushing: scene, episodes, rewards and environment."""

from ppt_rl.envs.push.env import PushEnv, PushRewards
from ppt_rl.envs.push.episode import PushRandomisation

__all__ = ["PushEnv", "PushRandomisation", "PushRewards"]
