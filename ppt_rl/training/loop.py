"""The training loop that every recipe runs: collect, improve, log, save."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from torch import nn
from torchrl.collectors import Collector
from torchrl.envs import EnvBase
from torchrl.modules import ProbabilisticActor
from tqdm import tqdm

from ppt_rl.training.constrained import ConstrainedLearner
from ppt_rl.training.interrupt import Interrupt
from ppt_rl.training.lagrangian import require_cost
from ppt_rl.training.logs import RunLogs
from ppt_rl.training.output import despite_closed_output
from ppt_rl.training.ppo import Learner
from ppt_rl.training.progress import Progress, TrainingRun

__all__ = ["train_ppo"]


def train_ppo(env: EnvBase, actor: ProbabilisticActor, critic: nn.Module, run: TrainingRun) -> Path:
    """Train until the budget of control steps is spent. Ctrl-C ends it early, after a checkpoint was written.

    Checkpoints are written between batches only, from finite networks. So whatever else ends a run, its last checkpoint
    stays as it was.

    Args:
        env: batch-locked environment with the recipe's chain.
        actor: policy, read by the collector.
        critic: value network.
        run: budget, place and what to resume from.

    Returns:
        Path of the last checkpoint.

    Raises:
        KeyError: if the run limits a cost that the environment does not have.
        KeyboardInterrupt: after the checkpoint, if Ctrl-C, SIGTERM or SIGHUP interrupted the run.
        TrainingDiverged: if an update is not finite.
    """
    progress = Progress(run, _learner(env, actor, critic, run))
    if run.resume_from is not None:
        progress.restore(env)
    budget = run.ppo.total_control_steps
    options = run.metadata.get("config", {})
    logs = RunLogs(run.run_dir, progress.control_steps, loggers=run.loggers, options=options)
    collector = _collector(env, actor, run.policy_steps)
    bar = tqdm(total=budget, initial=progress.control_steps, unit=" steps", unit_scale=True)
    batches = iter(collector)
    interrupt = Interrupt()
    try:
        progress.start_clock()
        if progress.batches == 0:
            logs.write(progress.validate(), 0)
        while progress.control_steps < budget and interrupt.requested is None:
            scalars = progress.learn(next(batches))
            logs.write(scalars | progress.validate(), progress.control_steps)
            with despite_closed_output():
                bar.update(progress.control_steps - bar.n)
                bar.set_postfix(progress.shown())
            if progress.batches % run.ppo.checkpoint_every == 0:
                logs.flush()
                progress.save()
        logs.flush()
        path = progress.save()
    finally:
        interrupt.restore()
        collector.shutdown()
        with despite_closed_output():
            bar.close()
        with suppress(OSError):  # what ended the run is told, not that its logs cannot be closed
            logs.close()
    interrupt.raise_if_requested()
    return path


def _learner(env: EnvBase, actor: ProbabilisticActor, critic: nn.Module, run: TrainingRun) -> Learner:
    """PPO, under the run's limit on a cost where it has one."""
    if run.constraint is None:
        return Learner(actor, critic, run.ppo, run.update_threads)
    require_cost(env, run.constraint.cost_key)
    return ConstrainedLearner(actor, critic, run.ppo, run.constraint, run.update_threads)


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
