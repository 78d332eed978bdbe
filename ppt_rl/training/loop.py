"""The training loop that every recipe runs: collect, improve, log, save."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tensordict import TensorDictBase
from torch import nn
from torchrl.checkpoint import GlobalRNGState
from torchrl.collectors import Collector
from torchrl.envs import EnvBase
from torchrl.modules import ProbabilisticActor
from tqdm import tqdm

from ppt_rl.modules.actor_critic import update_input_norm
from ppt_rl.training.checkpoint import load_checkpoint, save_checkpoint
from ppt_rl.training.interrupt import Interrupt
from ppt_rl.training.logs import RunLogs
from ppt_rl.training.ppo import Learner, PPOConfig

__all__ = ["TrainingRun", "batch_statistics", "control_steps", "train_ppo"]

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
    """

    ppo: PPOConfig
    policy_steps: int
    run_dir: Path
    metadata: Mapping[str, Any]
    extra: Mapping[str, nn.Module] = field(default_factory=dict)
    resume_from: Path | None = None


def train_ppo(env: EnvBase, actor: ProbabilisticActor, critic: nn.Module, run: TrainingRun) -> Path:
    """Train until the budget of control steps is spent. Ctrl-C ends it early, after a checkpoint was written.

    Args:
        env: batch-locked environment with the recipe's chain.
        actor: policy, read by the collector.
        critic: value network.
        run: budget, place and what to resume from.

    Returns:
        Path of the last checkpoint.

    Raises:
        KeyboardInterrupt: after the checkpoint, if the run was interrupted.
    """
    learner = Learner(actor, critic, run.ppo)
    progress = _Progress(run, learner)
    if run.resume_from is not None:
        progress.restore(env)
    logs = RunLogs(run.run_dir, last_step=progress.control_steps)
    collector = _collector(env, actor, run.policy_steps)
    budget = run.ppo.total_control_steps
    bar = tqdm(total=budget, initial=progress.control_steps, unit=" steps", unit_scale=True)
    batches = iter(collector)
    interrupt = Interrupt()
    try:
        progress.start_clock()
        while progress.control_steps < budget and not interrupt.requested:
            batch = next(batches)
            scalars = batch_statistics(batch) | learner.update(batch)
            for module in (actor, critic):
                update_input_norm(module, batch)  # after the update: the batch was collected with the old statistics
            steps = progress.add(batch, scalars)
            logs.write(scalars, progress.control_steps)
            bar.update(steps)
            bar.set_postfix(progress.shown())
            if progress.batches % run.ppo.checkpoint_every == 0:
                progress.save()
    finally:
        path = progress.save()
        bar.close()
        logs.close()
        collector.shutdown()
        interrupt.restore()
    if interrupt.requested:
        raise KeyboardInterrupt
    return path


def _collector(env: EnvBase, actor: ProbabilisticActor, policy_steps: int) -> Collector:
    """Collects batches of so many policy steps of every environment."""
    return Collector(
        env,
        actor,
        frames_per_batch=env.numel() * policy_steps,
        total_frames=-1,
        trust_policy=True,
        auto_register_policy_transforms=False,
    )


class _Progress:
    """How far a run has come, and its checkpoints."""

    def __init__(self, run: TrainingRun, learner: Learner) -> None:
        self._run = run
        self.control_steps, self.batches, self.seconds = 0, 0, 0.0
        self._latest = {"success": 0.0, "max_power": 0.0}
        self._components = {
            "actor": learner.actor, "critic": learner.critic, "optimizer": learner.optimizer,
            "schedule": learner.schedule, "rng": GlobalRNGState(), **run.extra,
        }  # fmt: skip
        self.start_clock()

    def start_clock(self) -> None:
        self._started = time.perf_counter() - self.seconds

    def restore(self, env: EnvBase) -> None:
        """Load the checkpoint to resume from and let the environment draw other episodes than those already seen."""
        assert self._run.resume_from is not None
        counters = load_checkpoint(self._run.resume_from, {**self._components, "counters": self._counters()})
        for name, value in counters["counters"].items():
            setattr(self, name, value)
        env.set_seed(int(self._run.metadata["config"]["seed"]) + _SEED_STRIDE * self.batches)

    def add(self, batch: TensorDictBase, scalars: dict[str, float]) -> int:
        """Count a batch; its time goes into the scalars. Returns its control steps."""
        steps = control_steps(batch)
        self._latest |= {name: scalars[name] for name in self._latest if name in scalars}
        self.control_steps += steps
        self.batches += 1
        self.seconds = scalars["seconds"] = time.perf_counter() - self._started
        return steps

    def shown(self) -> dict[str, str]:
        """What stands beside the progress bar."""
        return {"success": f"{self._latest['success']:.0%}", "max_power": f"{self._latest['max_power']:.2f} W"}

    def save(self) -> Path:
        """Write a checkpoint."""
        return save_checkpoint(
            self._run.run_dir,
            {**self._components, "counters": self._counters()},
            step=self.control_steps,
            metadata={**self._run.metadata, "success": self._latest["success"]},
        )

    def _counters(self) -> dict[str, Any]:
        return {"control_steps": self.control_steps, "batches": self.batches, "seconds": self.seconds}


def control_steps(batch: TensorDictBase) -> int:
    """Control steps in a batch; without a macro step, every policy step is one.

    Args:
        batch: what the collector returned.

    Returns:
        Their number.
    """
    steps = batch.get(("next", "control_steps"), None)
    return batch.numel() if steps is None else int(steps.sum())


def batch_statistics(batch: TensorDictBase) -> dict[str, float]:
    """Means over the episodes that ended in a batch; rewards are those of a policy step.

    Args:
        batch: what the collector returned.

    Returns:
        ``reward`` and, where the task has them, the reward groups by name; where episodes ended, also ``success``,
        ``progress`` and each metric.
    """
    following = batch["next"]
    terms = following.get("reward_terms", following.empty())
    statistics = {"reward": following["reward"].mean()}
    statistics |= {f"reward_{name}": terms[name].mean() for name in terms.keys()}
    done = following["done"].squeeze(-1)
    if bool(done.any()):
        ended = following[done]
        statistics |= {"success": ended["success"].float().mean(), "progress": ended["progress"].mean()}
        statistics |= {name: ended["metrics", name].mean() for name in following["metrics"].keys()}
    return {name: float(value) for name, value in statistics.items()}
