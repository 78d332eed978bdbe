"""The environments of the Franka Emika Panda."""

from __future__ import annotations

from typing import Any

from ppt_rl.arms import PANDA, Arm
from ppt_rl.envs.arm import ArmEnv
from ppt_rl.envs.maze import MazeEnv
from ppt_rl.envs.push import PushEnv
from ppt_rl.functional.argument_checks import require_instance

__all__ = ["PandaEnv", "PandaMazeEnv", "PandaPushEnv"]


class PandaEnv(ArmEnv):
    """:class:`ArmEnv` of the Panda.

    Args:
        num_envs: number of environments.
        arm: the Panda.
        **kwargs: as for :class:`ArmEnv`.

    Raises:
        ValueError: if the arm is another one.
    """

    def __init__(self, num_envs: int = 1, *, arm: Arm = PANDA, **kwargs: Any) -> None:
        require_instance("arm", arm, Arm)
        if arm != PANDA:
            raise ValueError(
                f"arm is {arm.name!r}, but {type(self).__name__} is the Panda's environment. "
                "Use ArmEnv, PushEnv or MazeEnv with other arms."
            )
        super().__init__(num_envs, arm=arm, **kwargs)


class PandaPushEnv(PushEnv, PandaEnv):
    """:class:`PushEnv` of the Panda; its arguments are the same."""


class PandaMazeEnv(MazeEnv, PandaEnv):
    """:class:`MazeEnv` of the Panda; its arguments are the same."""
