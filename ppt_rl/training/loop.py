"""The training loop that every recipe runs: collect, improve, log, keep."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable, Mapping
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
from ppt_rl.training.logs import RunLogs
from ppt_rl.training.ppo import Learner, PPOConfig

__all__ = ["batch_statistics", "control_steps", "train_ppo"]


def train_ppo(
    env: EnvBase,
    actor: ProbabilisticActor,
    critic: nn.Module,
    config: PPOConfig,
    *,
    policy_steps: int,
    run_dir: Path,
    variant: str,
    run_config: Mapping[str, Any],
    extra: Mapping[str, Any] | None = None,
    resume_from: Path | None = None,
    on_batch: Callable[[int, dict[str, float]], None] | None = None,
) -> Path:
    """Train until the budget of control steps is spent. Ctrl-C ends it early, with a good checkpoint written first.

    Args:
        env: batch-locked environment with the recipe's chain.
        actor: policy, read by the collector.
        critic: value network.
        config: settings.
        policy_steps: policy steps of every environment in a batch: an episode, or a part of one.
        run_dir: where logs and checkpoints go.
        variant: name of the recipe's variant, kept in the checkpoint.
        run_config: configuration of the run, kept in the checkpoint.
        extra: further modules to checkpoint, such as the movement primitive.
        resume_from: checkpoint to go on from.
        on_batch: called with the number of the batch and its log.

    Returns:
        Path of the last checkpoint.
    """
    learner = Learner(actor, critic, config)
    counters: dict[str, Any] = {"control_steps": 0, "batches": 0, "seconds": 0.0}
    components = {
        "actor": actor, "critic": critic, "optimizer": learner.optimizer, "schedule": learner.schedule,
        "rng": GlobalRNGState(), **(extra or {}),
    }  # fmt: skip
    if resume_from is not None:
        counters |= load_checkpoint(resume_from, {**components, "counters": dict(counters)})["counters"]
        env.set_seed(
            int(run_config["seed"]) + 1_000_003 * counters["batches"]
        )  # other episodes than those already seen
    logs = RunLogs(run_dir, last_step=counters["control_steps"])
    collector = Collector(
        env,
        actor,
        frames_per_batch=env.numel() * policy_steps,
        total_frames=-1,
        trust_policy=True,
        auto_register_policy_transforms=False,
    )
    bar = tqdm(total=config.total_control_steps, initial=counters["control_steps"], unit=" steps", unit_scale=True)
    shown, path = {"success": 0.0, "max_power": 0.0}, None
    batches = iter(collector)
    started = time.perf_counter() - counters["seconds"]
    interrupt = _Interrupt()
    try:
        while counters["control_steps"] < config.total_control_steps and not interrupt.asked:
            batch = next(batches)
            scalars = batch_statistics(batch) | learner.update(batch)
            for module in (actor, critic):
                update_input_norm(module, batch)  # after the update: the batch was collected with the old statistics
            shown |= scalars
            steps = control_steps(batch)
            counters["control_steps"] += steps
            counters["batches"] += 1
            counters["seconds"] = scalars["seconds"] = time.perf_counter() - started
            logs.write(scalars, counters["control_steps"])
            bar.update(steps)
            bar.set_postfix(success=f"{shown['success']:.0%}", max_power=f"{shown['max_power']:.2f} W")
            if on_batch is not None:
                on_batch(counters["batches"], scalars)
            if counters["batches"] % config.checkpoint_every == 0:
                path = _save(run_dir, components, counters, variant, run_config, shown["success"])
    finally:
        path = _save(run_dir, components, counters, variant, run_config, shown["success"])
        bar.close()
        logs.close()
        collector.shutdown()
        interrupt.restore()
    if interrupt.asked:
        raise KeyboardInterrupt
    return path


class _Interrupt:
    """Turns the first Ctrl-C into a request that a loop can ask for; the second one interrupts at once."""

    def __init__(self) -> None:
        self.asked = False
        main = threading.current_thread() is threading.main_thread()
        self._old = signal.signal(signal.SIGINT, self._ask) if main else None

    def _ask(self, number: int, frame: object) -> None:
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True
        message = "\nInterrupted: the batch is finished and a checkpoint written, then go on by --resume.\n"
        sys.stderr.write(message)

    def restore(self) -> None:
        """Give Ctrl-C back."""
        if self._old is not None:
            signal.signal(signal.SIGINT, self._old)


def _save(
    run_dir: Path, components: Mapping[str, Any], counters: Mapping[str, Any], variant: str, config: Mapping[str, Any],
    success: float,
) -> Path:  # fmt: skip
    parts = {**components, "counters": dict(counters)}
    step = int(counters["control_steps"])
    return save_checkpoint(run_dir, parts, step=step, variant=variant, config=config, success=success)


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
        ``reward`` and each reward group by name; where episodes ended, also ``success``, ``progress`` and each metric.
    """
    following = batch["next"]
    terms = following["reward_terms"]
    statistics = {"reward": following["reward"].mean()}
    statistics |= {f"reward_{name}": terms[name].mean() for name in terms.keys()}
    done = following["done"].squeeze(-1)
    if bool(done.any()):
        ended = following[done]
        statistics |= {"success": ended["success"].float().mean(), "progress": ended["progress"].mean()}
        statistics |= {name: ended["metrics", name].mean() for name in following["metrics"].keys()}
    return {name: float(value) for name, value in statistics.items()}
