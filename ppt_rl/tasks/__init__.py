"""What binds each task to learning, a folder each: options, prior, baselines, figures and the ``Task`` itself."""

from ppt_rl.tasks.config import (
    TaskConfig,
    damping_key,
    env_settings,
    episode_metrics,
    make_controller,
    motor_tank,
    tank_law,
    wrench_law,
)

__all__ = [
    "TaskConfig",
    "damping_key",
    "env_settings",
    "episode_metrics",
    "make_controller",
    "motor_tank",
    "tank_law",
    "wrench_law",
]
