"""Box pushing: scene, episodes, rewards and environment."""

from ppt_rl.envs.push.env import PandaPushEnv, PushRewards
from ppt_rl.envs.push.episode import PushRandomisation

__all__ = ["PandaPushEnv", "PushRandomisation", "PushRewards"]
