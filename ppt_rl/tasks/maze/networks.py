"""Actor and critic of the maze recipes."""

from __future__ import annotations

from collections.abc import Sequence

from torch import nn
from torchrl.envs import TransformedEnv

from ppt_rl.modules.actor_critic import Mirror
from ppt_rl.tasks.maze.config import MAZE_AXES
from ppt_rl.training import make_actor_critic

__all__ = ["MAZE_PRIVILEGED", "make_maze_policy"]

#: What a policy may read: proprioception and wrench, in heading axes.
_KNOWN = ("heading_twist", "heading_wrench")
#: A maze and its mirror image are alike. Signs under reflection: of twist and wrench, and of ahead, left and up.
_MIRRORED_TWIST, _MIRRORED_AXES = (1.0, -1.0, 1.0, -1.0, 1.0, -1.0), (1.0, -1.0, 1.0)
#: Observations that exist in simulation only; no evaluated policy sees them.
MAZE_PRIVILEGED = ("corridor_offset", "corridor_heading")


def make_maze_policy(
    env: TransformedEnv, *, initial_scale: float, extra_keys: Sequence[str] = (), vector_keys: Sequence[str] = ()
) -> tuple[nn.Module, nn.Module]:
    """Actor on proprioception and touch, with mirror symmetry; the critic also reads where in the corridor the tool is.

    Args:
        env: environment with the recipe's chain.
        initial_scale: standard deviation of the untrained policy [action units].
        extra_keys: further observations, which the recipe's transforms add; they must not change under reflection.
        vector_keys: further observations of two numbers, ahead and to the left.

    Returns:
        Actor and critic.
    """
    keys = [*_KNOWN, *vector_keys, *extra_keys]
    same = sum(env.observation_spec[key].shape[-1] for key in extra_keys)
    per_axis = env.full_action_spec["action"].shape[-1] // len(MAZE_AXES)  # numbers of the action, axis by axis
    mirror = Mirror(
        (*_MIRRORED_TWIST * len(_KNOWN), *(1.0, -1.0) * len(vector_keys), *(1.0,) * same),
        [sign for sign in _MIRRORED_AXES for _ in range(per_axis)],
    )
    return make_actor_critic(
        env, keys, [*keys, "heading", *MAZE_PRIVILEGED], initial_scale=initial_scale, mirror=mirror
    )
