"""Proximal policy optimisation as every recipe runs it."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.checkpoint import GlobalRNGState
from torchrl.collectors import Collector
from torchrl.envs import EnvBase
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import ClipPPOLoss, KLAdaptiveLR
from torchrl.objectives.value import GAE
from tqdm import tqdm

from ppt_rl.modules.actor_critic import update_input_norm
from ppt_rl.training.checkpoint import load_checkpoint, save_checkpoint
from ppt_rl.training.logs import RunLogs

__all__ = ["PPOConfig", "train_ppo"]

#: Policy steps in a batch from which on an update is worth every CPU.
_LARGE = 4096


@dataclass(frozen=True)
class PPOConfig:
    """Settings of PPO.

    Attributes:
        total_control_steps: budget, summed over environments [control steps].
        epochs: passes over a batch.
        minibatches: parts of a batch in a pass.
        learning_rate: at the start; the KL divergence adapts it.
        max_learning_rate: upper bound of the adapted rate.
        target_kl: divergence per update that the rate aims at [nat].
        clip: epsilon of the clipped objective.
        entropy: weight of the entropy bonus.
        gamma: discount per control step.
        gae_lambda: of the generalised advantage estimate.
        max_grad_norm: bound on the gradient's norm.
        checkpoint_every: batches between checkpoints.
    """

    total_control_steps: int = 921_600
    epochs: int = 8
    minibatches: int = 4
    learning_rate: float = 3e-4
    max_learning_rate: float = 2e-3
    target_kl: float = 0.02
    clip: float = 0.2
    entropy: float = 0.0
    gamma: float = 1.0
    gae_lambda: float = 0.95
    max_grad_norm: float = 1.0
    checkpoint_every: int = 5

    def __post_init__(self) -> None:
        """Refuse impossible settings."""
        for name, value in asdict(self).items():
            if value < 0 or (value == 0 and name not in ("entropy", "total_control_steps")):
                raise ValueError(f"{name} is {value}; expected a number above 0.")
        for name in ("gamma", "gae_lambda"):
            if getattr(self, name) > 1:
                raise ValueError(f"{name} is {getattr(self, name)}; expected at most 1.")


@contextmanager
def _threads(count: int) -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


class _Learner:
    """Losses, optimizer and learning-rate schedule of one run."""

    def __init__(self, actor: ProbabilisticActor, critic: nn.Module, config: PPOConfig) -> None:
        self.actor, self.critic, self.config = actor, critic, config
        self.advantage = GAE(gamma=config.gamma, lmbda=config.gae_lambda, value_network=critic, average_gae=False)
        # A step-wise batch has no such entry: then every policy step is one control step.
        self.advantage.set_keys(steps_to_next_obs=("next", "control_steps"))
        self.loss = ClipPPOLoss(
            actor, critic, clip_epsilon=config.clip, entropy_bonus=config.entropy > 0, entropy_coeff=config.entropy,
            critic_coeff=1.0, normalize_advantage=True, loss_critic_type="smooth_l1",
        )  # fmt: skip
        self.optimizer = torch.optim.Adam(self.loss.parameters(), lr=config.learning_rate, eps=1e-5)
        self.schedule = KLAdaptiveLR(self.optimizer, config.target_kl, max_lr=config.max_learning_rate)

    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """Improve actor and critic on one batch: fewer passes than allowed where the policy has moved far enough."""
        with _threads(len(os.sched_getaffinity(0)) if batch.numel() > _LARGE else torch.get_num_threads()):
            return self._improve(self._with_advantage(batch))

    def _improve(self, batch: TensorDictBase) -> dict[str, float]:
        config, totals, updates = self.config, torch.zeros(2), 0
        for _ in range(config.epochs):
            for rows in torch.randperm(len(batch)).chunk(config.minibatches):
                losses = self.loss(batch[rows])
                total = losses["loss_objective"] + losses["loss_critic"] + losses.get("loss_entropy", torch.zeros(()))
                self.optimizer.zero_grad()
                total.backward()
                nn.utils.clip_grad_norm_(self.loss.parameters(), config.max_grad_norm)
                self.optimizer.step()
                totals += torch.stack([losses["loss_objective"].detach(), losses["loss_critic"].detach()])
                updates += 1
            divergence = self._divergence(batch)
            self.schedule.step(divergence)
            if divergence > 2 * config.target_kl:
                break
        objective, critic = (totals / updates).tolist()
        rate = self.optimizer.param_groups[0]["lr"]
        return {
            "loss_objective": objective, "loss_critic": critic, "kl": float(divergence), "learning_rate": rate,
        }  # fmt: skip

    @torch.no_grad()
    def _with_advantage(self, batch: TensorDictBase) -> TensorDictBase:
        """A flat batch of what the loss reads: a step-wise batch is large, so the rest is left behind."""
        batch = self.advantage(batch)
        keys = {"loc", "scale", "advantage", "value_target", *self.loss.in_keys}
        return batch.select(*keys, strict=False).reshape(-1)

    @torch.no_grad()
    def _divergence(self, batch: TensorDictBase) -> Tensor:
        """Mean KL divergence from the policy that acted to the present one, exact for Gaussians.

        The loss's own ``kl_approx`` is a sample mean: with a hundred actions its noise is larger than the target.
        """
        old = torch.distributions.Normal(batch["loc"], batch["scale"])
        acting = self.actor.get_dist(batch.select(*self.actor.in_keys))
        return torch.distributions.kl_divergence(old, acting.base_dist).sum(-1).mean()


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
    learner = _Learner(actor, critic, config)
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
