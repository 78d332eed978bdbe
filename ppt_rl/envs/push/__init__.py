"""Box pushing: scene, episodes, rewards and environment."""

from ppt_rl.envs.push.env import PushEnv, PushGoal
from ppt_rl.envs.push.episode import PushRandomisation
from ppt_rl.envs.push.obstacles import HAND, WALL, Obstacle, Plate
from ppt_rl.envs.push.obstructed import ObstructedPushEnv
from ppt_rl.envs.push.reference import PushReference
from ppt_rl.envs.push.rewards import PushRewards

__all__ = [
    "HAND",
    "WALL",
    "Obstacle",
    "ObstructedPushEnv",
    "Plate",
    "PushEnv",
    "PushGoal",
    "PushRandomisation",
    "PushReference",
    "PushRewards",
]
