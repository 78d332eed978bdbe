"""What binds each task to learning: a folder a task."""

from ppt_rl.tasks.config import TaskConfig, episode_metrics, make_controller, prepare_torch

__all__ = ["TaskConfig", "episode_metrics", "make_controller", "prepare_torch"]
