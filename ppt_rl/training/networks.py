"""Actor and critic sized for an environment."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import nn
from torchrl.envs import EnvBase

from ppt_rl.modules.actor_critic import Mirror, make_actor, make_critic, update_input_norm

__all__ = ["begin_norms", "make_actor_critic", "make_cost_critic"]


def make_actor_critic(
    env: EnvBase,
    actor_keys: Sequence[str],
    critic_keys: Sequence[str],
    *,
    initial_scale: float,
    mirror: Mirror | None = None,
) -> tuple[nn.Module, nn.Module]:
    """Actor and critic sized for an environment.

    Both normalise their inputs with running statistics. A training of a run keeps them; in a loop of your own, call
    :func:`begin_norms` before the first batch and :func:`~ppt_rl.modules.update_input_norm` after each update.

    Args:
        env: environment with the recipe's chain.
        actor_keys: observations of the policy; none of them privileged.
        critic_keys: observations of the value network.
        initial_scale: standard deviation of the untrained policy [action units].
        mirror: mirror symmetry that the policy shall have.

    Returns:
        Actor and critic.

    Raises:
        KeyError: if an observation is unknown.
    """
    _require_observed(env, [*actor_keys, *critic_keys])
    size = env.full_action_spec["action"].shape[-1]
    actor = make_actor(list(actor_keys), _width(env, actor_keys), size, initial_scale=initial_scale, mirror=mirror)
    return actor.to(env.device), make_critic(list(critic_keys), _width(env, critic_keys)).to(env.device)


def make_cost_critic(env: EnvBase, keys: Sequence[str]) -> nn.Module:
    """Value network of a cost, sized for an environment.

    Args:
        env: environment with the recipe's chain.
        keys: observations that it reads.

    Returns:
        The network, which writes ``cost_value``.

    Raises:
        KeyError: if an observation is unknown.
    """
    _require_observed(env, keys)
    return make_critic(list(keys), _width(env, keys), out_key="cost_value").to(env.device)


def _require_observed(env: EnvBase, keys: Sequence[str]) -> None:
    known = list(env.observation_spec.keys(True, True))
    unknown = [key for key in keys if key not in known]
    if unknown:
        raise KeyError(f"observations {unknown} are unknown; expected some of {known}.")


def _width(env: EnvBase, keys: Sequence[str]) -> int:
    return sum(env.observation_spec[key].shape[-1] for key in keys)


def begin_norms(env: EnvBase, modules: Sequence[nn.Module], resets: int = 4) -> None:
    """Initialise the input statistics from the first observations of fresh episodes; training then updates them.

    Args:
        env: environment with the recipe's chain.
        modules: actor and critic.
        resets: number of batches of episodes.

    Raises:
        ValueError: if a module has no input statistics.
        KeyError: if the environment lacks an observation that a module reads.
    """
    samples = [env.reset() for _ in range(resets)]
    data = torch.cat([sample.select(*env.observation_keys) for sample in samples])
    for module in modules:
        update_input_norm(module, data)
