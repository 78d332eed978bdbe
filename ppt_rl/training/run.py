"""A training run in its directory: fresh, or continued from its newest checkpoint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from torch import nn
from torchrl.envs import EnvBase

from ppt_rl.training.checkpoint import CheckpointMismatch, checkpoint_info, find_checkpoint
from ppt_rl.training.config import RunConfig, as_json
from ppt_rl.training.logs import save_config
from ppt_rl.training.loop import TrainingRun, train_ppo
from ppt_rl.training.networks import begin_norms

__all__ = ["Learners", "train_in_run_dir"]

#: Options that may differ between a run and its continuation: place and threads.
_FREE = {"run_dir", "resume", "num_threads", "torch_threads"}


@dataclass(frozen=True)
class Learners:
    """What a run trains and saves.

    Attributes:
        actor: policy.
        critic: value network.
        extra: further modules to save, by name, such as the movement primitive.
    """

    actor: nn.Module
    critic: nn.Module
    extra: Mapping[str, nn.Module] = field(default_factory=dict)


def train_in_run_dir(
    config: RunConfig, env: EnvBase, learners: Learners, *, policy_steps: int, identity: Mapping[str, str]
) -> Path:
    """Train in ``config.run_dir``, afresh or from its newest checkpoint.

    Args:
        config: options of the run.
        env: environment with the recipe's chain.
        learners: networks and modules.
        policy_steps: policy steps of every environment in a batch: an episode, or a part of one.
        identity: what the checkpoints say of their origin: ``variant``, and ``recipe`` where it is a user's file.

    Returns:
        Path of the last checkpoint.

    Raises:
        CheckpointMismatch: if the directory holds a run that is not to be resumed, or one that does not fit.
    """
    run_dir, settings = Path(config.run_dir), as_json(config)
    resume_from = None
    if config.resume:
        resume_from = find_checkpoint(run_dir)
        old = checkpoint_info(resume_from, identity["variant"])["config"]
        _check_same_run(_completed(old, as_json(type(config)())), settings, resume_from)
    elif (run_dir / "checkpoints").exists():
        raise CheckpointMismatch(
            f"{run_dir} holds a run already. Continue it with --resume, or name another directory with --run-dir."
        )
    else:
        begin_norms(env, [learners.actor, learners.critic])
    save_config(run_dir, settings | dict(identity))
    run = TrainingRun(
        config.ppo,
        policy_steps=policy_steps,
        run_dir=run_dir,
        metadata={**identity, "config": settings},
        extra=learners.extra,
        resume_from=resume_from,
    )
    return train_ppo(env, learners.actor, learners.critic, run)


def _completed(old: Mapping[str, Any], defaults: Mapping[str, Any]) -> dict[str, Any]:
    """Settings of an older version, in which options that have come since have their defaults."""
    return {**defaults, **old, "ppo": {**defaults["ppo"], **old["ppo"]}}


def _check_same_run(old: Mapping[str, Any], new: Mapping[str, Any], path: Path) -> None:
    """Refuse to resume with another configuration; the budget may differ too."""
    differing = [key for key in new if key not in _FREE and key != "ppo" and old.get(key) != new[key]]
    differing += [
        f"ppo.{key}" for key in new["ppo"] if key != "total_control_steps" and old["ppo"].get(key) != new["ppo"][key]
    ]
    if differing:
        raise CheckpointMismatch(
            f"{path} was trained with other values of {', '.join(differing)}; expected the same as now. Resume with "
            "the options in config.json, or start another run with --run-dir."
        )
