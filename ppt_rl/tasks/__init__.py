"""What binds each task to learning, a folder each: options, prior, baselines, figures and the ``Task`` itself."""

from ppt_rl.tasks.config import TaskConfig, env_settings, episode_metrics, make_controller, motor_tank

__all__ = ["TaskConfig", "env_settings", "episode_metrics", "make_controller", "motor_tank"]
