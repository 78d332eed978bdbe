"""A training run in its directory: fresh, or continued from a checkpoint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from torch import nn
from torchrl.envs import EnvBase

from ppt_rl.training.checkpoint import CheckpointMismatch, checkpoint_info
from ppt_rl.training.config import RunConfig, as_json
from ppt_rl.training.directory import checkpoint_to_resume, only_process_in, remove_leftovers, set_aside_newer
from ppt_rl.training.lagrangian import Constraint
from ppt_rl.training.logs import save_config
from ppt_rl.training.loop import train_ppo
from ppt_rl.training.networks import begin_norms
from ppt_rl.training.progress import TrainingRun
from ppt_rl.training.validation import Validation

__all__ = ["Learners", "train_in_run_dir"]

#: Options that may differ between a run and its continuation: place, threads, loggers and budget.
_FREE = {"run_dir", "resume", "num_threads", "torch_threads", "update_threads", "logger", "ppo.total_control_steps"}


@dataclass(frozen=True)
class Learners:
    """What a run trains and saves.

    Attributes:
        actor: policy.
        critic: value network.
        extra: further modules to save, by name, such as the movement primitive.
        constraint: limit on the cost of an episode; None leaves the reward alone.
    """

    actor: nn.Module
    critic: nn.Module
    extra: Mapping[str, nn.Module] = field(default_factory=dict)
    constraint: Constraint | None = None

    @property
    def networks(self) -> list[nn.Module]:
        """Actor and critics, those with statistics of their inputs."""
        cost_critic = None if self.constraint is None else self.constraint.cost_critic
        return [self.actor, self.critic, *([] if cost_critic is None else [cost_critic])]


def train_in_run_dir(
    config: RunConfig, env: EnvBase, learners: Learners, *, policy_steps: int, identity: Mapping[str, str],
    validation: Validation | None = None,
) -> Path:  # fmt: skip
    """Train in ``config.run_dir``: afresh, from its newest checkpoint that can be read, or from the one that is named.

    Args:
        config: options of the run.
        env: environment with the recipe's chain.
        learners: networks and modules.
        policy_steps: policy steps of every environment in a batch: an episode, or a part of one.
        identity: what the checkpoints say of their origin: ``variant``, and ``recipe`` where it is a user's file.
        validation: when and how the policy is validated; None does without.

    Returns:
        Path of the last checkpoint.

    Raises:
        CheckpointMismatch: if the directory holds a run that is not to be resumed or one that does not fit, or if
            another process trains in it.
        TrainingDiverged: if an update is not finite; the last checkpoint stays.
    """
    run_dir, settings = Path(config.run_dir), as_json(config)
    with only_process_in(run_dir):
        remove_leftovers(run_dir)
        resume_from = checkpoint_to_resume(config)
        if resume_from is None:
            begin_norms(env, learners.networks)
        else:
            old = checkpoint_info(resume_from, identity["variant"])["config"]
            _check_same_run(_completed(old, as_json(type(config)())), settings, resume_from)
            set_aside_newer(run_dir, resume_from)
        save_config(run_dir, settings | dict(identity))
        run = TrainingRun(
            config.ppo,
            policy_steps=policy_steps,
            run_dir=run_dir,
            metadata={**identity, "config": settings},
            extra=learners.extra,
            resume_from=resume_from,
            validation=validation,
            constraint=learners.constraint,
            update_threads=config.update_threads or None,
            loggers=config.logger,
        )
        return train_ppo(env, learners.actor, learners.critic, run)


def _completed(old: Mapping[str, Any], defaults: Mapping[str, Any]) -> dict[str, Any]:
    """Settings of an older version, in which options that have come since have their defaults."""
    nested = {key: value for key, value in defaults.items() if isinstance(value, Mapping) and key in old}
    return {**defaults, **old, **{key: {**value, **old[key]} for key, value in nested.items()}}


def _check_same_run(old: Mapping[str, Any], new: Mapping[str, Any], path: Path) -> None:
    """Refuse to resume with another configuration; the budget may differ too."""
    then, now = (_flat(settings) for settings in (old, new))
    differing = [key for key in now if key not in _FREE and then.get(key) != now[key]]
    if differing:
        values = ", ".join(f"{key} ({then.get(key)} then, {now[key]} now)" for key in differing)
        raise CheckpointMismatch(
            f"{path} was trained with other values of {values}; expected the same as then. Leave these options out, "
            "since --resume takes those of the run, or start another run with --run-dir."
        )


def _flat(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings with those of a group as ``GROUP.NAME``."""
    groups = {key: value for key, value in settings.items() if isinstance(value, Mapping)}
    single = {key: value for key, value in settings.items() if key not in groups}
    return single | {f"{key}.{name}": value for key, group in groups.items() for name, value in group.items()}
