"""Actor and critic of the pushing recipes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from torch import nn
from torchrl.envs import TransformedEnv

from ppt_rl.modules.actor_critic import Mirror
from ppt_rl.tasks.push.config import PushConfig
from ppt_rl.tasks.push.prior import PUSH_AXES
from ppt_rl.training import make_actor_critic, make_cost_critic

__all__ = ["PRIVILEGED", "make_push_cost_critic", "make_push_policy"]

#: Signs of coordinates when left and right change places: of x, y and yaw; of twist and wrench; of a pose, whose
#: quaternion is negated besides, so that that of a tool which points down stays what it is.
_AXES, _TWIST, _POSE = (1, -1, -1), (1, -1, 1, -1, 1, -1), (1, -1, 1, -1, 1, -1, 1)
#: What a policy may read, in training and at test time, with its signs. The critic, needed in training only, reads the
#: box's pose too.
_KNOWN = {
    "box_start": (1, -1), "goal": (1, -1), "box_size": (1,), "pose": _POSE, "twist": _TWIST, "wrench": _TWIST,
    "phase": (1,),
}  # fmt: skip
#: What some chains add.
_FURTHER = {
    "goal_yaw": (-1,), "tank_energy": (1,), "valve": (1,), "energy_budget": (1,), "reference_position": _AXES,
    "last_action": _AXES,
}  # fmt: skip
#: Observations that exist in simulation only; no evaluated policy sees them.
PRIVILEGED = ("box_pose",)


def make_push_policy(
    config: PushConfig, env: TransformedEnv, *, initial_scale: float, extra_keys: Sequence[str] = (),
    beside: Sequence[int] = (), extra_signs: Mapping[str, Sequence[int]] | None = None,
) -> tuple[nn.Module, nn.Module]:  # fmt: skip
    """Actor on what is known at test time, critic on the box's pose as well.

    Args:
        config: options of the recipe.
        env: environment with the recipe's chain.
        initial_scale: standard deviation of the untrained policy [action units].
        extra_keys: further observations, which the recipe's transforms add.
        beside: signs, when left and right change places, of what the action holds after the numbers of x, y and yaw.
        extra_signs: such signs of further observations that no chain of the library adds, by key.

    Returns:
        Actor and critic.
    """
    keys = _actor_keys(config, extra_keys)
    signs = _KNOWN | _FURTHER | dict(extra_signs or {})
    per_axis = (env.full_action_spec["action"].shape[-1] - len(beside)) // len(PUSH_AXES)  # the action is axis by axis
    acted = [*(sign for sign in _AXES for _ in range(per_axis)), *beside]
    mirror = Mirror([sign for key in keys for sign in signs[key]], acted)
    return make_actor_critic(
        env, keys, [*keys, *PRIVILEGED], initial_scale=initial_scale, mirror=mirror if config.mirror else None
    )


def make_push_cost_critic(config: PushConfig, env: TransformedEnv, *, extra_keys: Sequence[str] = ()) -> nn.Module:
    """Value network of a cost, on what the critic of :func:`make_push_policy` reads.

    Args:
        config: options of the recipe.
        env: environment with the recipe's chain.
        extra_keys: further observations, which the recipe's transforms add.

    Returns:
        The critic, which writes ``cost_value``.
    """
    return make_cost_critic(env, [*_actor_keys(config, extra_keys), *PRIVILEGED])


def _actor_keys(config: PushConfig, extra_keys: Sequence[str]) -> list[str]:
    return [*_KNOWN, *(["goal_yaw"] if config.goal == "pose" else []), *extra_keys]
