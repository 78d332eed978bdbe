"""What every training recipe does around its own chain: networks, run directory, configuration, training."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any

import torch
from torch import nn
from torchrl.envs import EnvBase

from ppt_rl.modules.actor_critic import Mirror, make_actor, make_critic, update_input_norm
from ppt_rl.training.checkpoint import CheckpointMismatch, checkpoint_info, find_checkpoint
from ppt_rl.training.logs import save_config
from ppt_rl.training.loop import train_ppo
from ppt_rl.training.ppo import PPOConfig

__all__ = ["as_json", "make_actor_critic", "run_recipe"]


def as_json(config: Any) -> dict[str, Any]:
    """A configuration dataclass as plain JSON data.

    Args:
        config: dataclass instance; paths become strings, tuples lists.

    Returns:
        Its fields, nested.
    """
    if not is_dataclass(config) or isinstance(config, type):
        raise TypeError(f"config is a {type(config).__name__}; expected a dataclass instance.")
    return json.loads(json.dumps(asdict(config), default=str))


def make_actor_critic(
    env: EnvBase,
    actor_keys: Sequence[str],
    critic_keys: Sequence[str],
    *,
    initial_scale: float,
    mirror: Mirror | None = None,
) -> tuple[nn.Module, nn.Module]:
    """Actor and critic sized for an environment.

    Args:
        env: with the recipe's chain.
        actor_keys: observations of the policy: nothing privileged.
        critic_keys: observations of the value network.
        initial_scale: standard deviation of the untrained policy [action units].
        mirror: a symmetry that the policy shall have.

    Returns:
        Actor and critic.

    Raises:
        KeyError: if an observation is unknown.
    """
    spec = env.observation_spec
    unknown = [key for key in (*actor_keys, *critic_keys) if key not in spec.keys(True, True)]
    if unknown:
        raise KeyError(f"observations {unknown} are unknown; the environment has {list(spec.keys(True, True))}.")

    def width(keys: Sequence[str]) -> int:
        return sum(spec[key].shape[-1] for key in keys)

    size = env.full_action_spec["action"].shape[-1]
    actor = make_actor(list(actor_keys), width(actor_keys), size, initial_scale=initial_scale, mirror=mirror)
    return actor.to(env.device), make_critic(list(critic_keys), width(critic_keys)).to(env.device)


def begin_norms(env: EnvBase, modules: Sequence[nn.Module], resets: int = 4) -> None:
    """Begin the input statistics with starts of fresh episodes; training takes what it collects into them."""
    samples = [env.reset() for _ in range(resets)]
    data = torch.cat([sample.select(*env.observation_keys) for sample in samples])
    for module in modules:
        update_input_norm(module, data)


def run_recipe(
    variant: str,
    config: Any,
    env: EnvBase,
    actor: nn.Module,
    critic: nn.Module,
    *,
    policy_steps: int,
    extra: Mapping[str, nn.Module] | None = None,
) -> Path:
    """Train in ``config.run_dir``, afresh or on from its newest checkpoint.

    Args:
        variant: name of the recipe's variant.
        config: the recipe's dataclass, with ``run_dir``, ``seed``, ``resume`` and ``ppo``.
        env: environment with the recipe's chain.
        actor: policy.
        critic: value network.
        policy_steps: policy steps of every environment in a batch: an episode, or a part of one.
        extra: further modules to checkpoint.

    Returns:
        Path of the last checkpoint.

    Raises:
        CheckpointMismatch: if the directory holds a run and it is not to be resumed, or one that does not fit.
    """
    run_dir = Path(config.run_dir)
    settings: PPOConfig = config.ppo
    resume_from = None
    if config.resume:
        resume_from = find_checkpoint(run_dir)
        _check_same_run(checkpoint_info(resume_from, variant)["config"], as_json(config), resume_from)
    elif (run_dir / "checkpoints").exists():
        raise CheckpointMismatch(
            f"{run_dir} holds a run already. Go on with it by --resume, or name another directory by --run-dir."
        )
    else:
        begin_norms(env, [actor, critic])
    save_config(run_dir, as_json(config) | {"variant": variant})
    return train_ppo(
        env, actor, critic, settings, policy_steps=policy_steps, run_dir=run_dir, variant=variant,
        run_config=as_json(config), extra=extra, resume_from=resume_from,
    )  # fmt: skip


def _check_same_run(old: Mapping[str, Any], new: Mapping[str, Any], path: Path) -> None:
    """Refuse to resume with another configuration; budget, place and threads may differ."""
    free = {"run_dir", "resume", "num_threads", "torch_threads"}
    differing = [key for key in new if key not in free and key != "ppo" and old.get(key) != new[key]]
    differing += [
        f"ppo.{key}" for key in new["ppo"] if key != "total_control_steps" and old["ppo"].get(key) != new["ppo"][key]
    ]
    if differing:
        raise CheckpointMismatch(
            f"{path} was trained with other values of {', '.join(differing)}; expected the same as now. Resume with "
            "the options in config.json, or start another run by --run-dir."
        )
