"""What a training run has learnt, how far it has come, and its checkpoints."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tensordict import TensorDictBase
from torch import nn
from torchrl.checkpoint import GlobalRNGState
from torchrl.envs import EnvBase

from ppt_rl.modules.actor_critic import update_input_norm
from ppt_rl.training.batches import batch_statistics, control_steps
from ppt_rl.training.checkpoint import all_checkpoints, load_checkpoint, save_checkpoint
from ppt_rl.training.finite import TrainingDiverged, first_not_finite
from ppt_rl.training.lagrangian import Constraint
from ppt_rl.training.ppo import Learner, PPOConfig
from ppt_rl.training.validation import Validation

__all__ = ["Progress", "TrainingRun"]

#: A resumed run draws other episodes than those it has seen: its seed moves on by this much a batch.
_SEED_STRIDE = 1_000_003


@dataclass(frozen=True)
class TrainingRun:
    """What a training loop is told besides its environment and networks.

    Attributes:
        ppo: settings of PPO, with the budget.
        policy_steps: policy steps of every environment in a batch: an episode, or a part of one.
        run_dir: directory of logs and checkpoints.
        metadata: JSON data saved in every checkpoint: at least ``variant`` and ``config``.
        extra: further modules to save, by name.
        resume_from: checkpoint to continue from; None starts afresh.
        validation: when and how the policy is validated; None does without.
        constraint: limit on the cost of an episode; None leaves the reward alone.
        update_threads: threads of an update on the CPU; None takes one for each CPU.
        loggers: names of loggers, some of :data:`~ppt_rl.training.loggers.LOGGERS`.
    """

    ppo: PPOConfig
    policy_steps: int
    run_dir: Path
    metadata: Mapping[str, Any]
    extra: Mapping[str, nn.Module] = field(default_factory=dict)
    resume_from: Path | None = None
    validation: Validation | None = None
    constraint: Constraint | None = None
    update_threads: int | None = None
    loggers: tuple[str, ...] = ("csv", "tensorboard")


class Progress:
    """What a run has learnt, how far it has come, and its checkpoints.

    Args:
        run: place, metadata and what to resume from.
        learner: networks and optimizer.

    Attributes:
        control_steps: number of control steps so far, summed over environments.
        batches: number of batches so far.
        seconds: time of training so far [s].
    """

    def __init__(self, run: TrainingRun, learner: Learner) -> None:
        self._run, self._learner = run, learner
        self.control_steps, self.batches, self.seconds = 0, 0, 0.0
        self._latest = {"success": 0.0, "max_power": 0.0}
        self._components = {**learner.components, "rng": GlobalRNGState(), **run.extra}
        #: The last checkpoint, and the number of batches in it.
        self._last: tuple[Path, int] | None = None
        self.start_clock()

    def start_clock(self) -> None:
        """Count the time from now on, on top of what a resumed run has taken."""
        self._started = time.perf_counter() - self.seconds

    def restore(self, env: EnvBase) -> None:
        """Load the checkpoint to resume from and let the environment draw other episodes than those already seen.

        Args:
            env: environment to seed.

        Raises:
            CheckpointMismatch: if the checkpoint does not fit.
        """
        path = self._run.resume_from
        assert path is not None
        counters = load_checkpoint(path, {**self._components, "counters": self._counters()})
        for name, value in counters["counters"].items():
            setattr(self, name, value)
        env.set_seed(int(self._run.metadata["config"]["seed"]) + _SEED_STRIDE * self.batches)
        self._last = path, self.batches

    def learn(self, batch: TensorDictBase) -> dict[str, float]:
        """Improve the networks on a batch and count it.

        Args:
            batch: what the collector returned.

        Returns:
            Scalars to log, by name.

        Raises:
            TrainingDiverged: if the update, the networks or the optimizer are not finite; the batch is not counted.
        """
        learner = self._learner
        with self._advice_where_it_diverges():
            scalars = batch_statistics(batch) | (improved := learner.update(batch))
            for module in learner.networks.values():
                update_input_norm(module, batch)  # after the update: the batch was collected with the old statistics
            broken = first_not_finite({"update": improved, **learner.components})
            if broken is not None:
                raise TrainingDiverged(f"{broken} is not finite")
        self._latest |= {name: scalars[name] for name in self._latest if name in scalars}
        self.control_steps += control_steps(batch)
        self.batches += 1
        self.seconds = scalars["seconds"] = time.perf_counter() - self._started
        return scalars

    def validate(self) -> dict[str, float]:
        """Validate the policy where that is due.

        Returns:
            Scalars to log, by name; none where it is not due.
        """
        validation = self._run.validation
        return dict(validation.measure()) if validation is not None and validation.due(self.batches) else {}

    def shown(self) -> dict[str, str]:
        """Figures beside the progress bar.

        Returns:
            Text by name.
        """
        return {"success": f"{self._latest['success']:.0%}", "max_power": f"{self._latest['max_power']:.2f} W"}

    def save(self) -> Path:
        """Write a checkpoint, unless the last one in the run's directory holds all this already.

        Returns:
            Its path.

        Raises:
            TrainingDiverged: if something in it is not finite; nothing is written.
            OSError: if it cannot be written; the older checkpoints stay.
        """
        run_dir = self._run.run_dir
        if self._last is not None and self._last[1] == self.batches and self._last[0] in all_checkpoints(run_dir):
            return self._last[0]
        with self._advice_where_it_diverges():
            path = save_checkpoint(
                run_dir,
                {**self._components, "counters": self._counters()},
                step=self.control_steps,
                metadata={**self._run.metadata, "success": self._latest["success"]},
            )
        self._last = path, self.batches
        return path

    def _counters(self) -> dict[str, Any]:
        return {"control_steps": self.control_steps, "batches": self.batches, "seconds": self.seconds}

    @contextmanager
    def _advice_where_it_diverges(self) -> Iterator[None]:
        try:
            yield
        except TrainingDiverged as error:
            ppo = self._run.ppo
            where = (
                "starts afresh, since there is no checkpoint" if self._last is None else f"goes on from {self._last[0]}"
            )
            raise TrainingDiverged(
                f"the update after {self.control_steps:,} control steps is not finite: {error}. It was not saved. "
                f"--resume {where}; if this comes again, start another run with a lower --ppo.learning-rate "
                f"(now {ppo.learning_rate:g}) or --ppo.max-learning-rate (now {ppo.max_learning_rate:g})."
            ) from error
