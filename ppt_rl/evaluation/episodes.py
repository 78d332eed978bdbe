"""Deterministic evaluation: rows per episode, means with 95 % intervals."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import torch
from scipy import stats
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from ppt_rl.transforms.macro_step import MacroStepTransform

__all__ = [
    "POWER_AND_WORK",
    "REPORTED",
    "ZeroPolicy",
    "distribution",
    "interval",
    "record_episodes",
    "run_episodes",
    "summarise",
]

#: Metrics of the report, in order, with their units.
REPORTED = {
    "success": "0-1",
    "max_power": "W",
    "jerk_rms": "m/s^3",
    "wrench_p95": "N",
    "overload_ratio": "0-1",
    "contact_continuity": "0-1",
    "progress": "0-1",
}
#: Power and work of an audited episode with their units: at control rate, then over every physics substep (``audit_``).
POWER_AND_WORK = {
    "max_power": "W",
    "audit_commanded_power": "W",
    "max_power_measured": "W",
    "audit_measured_power": "W",
    "work": "J",
    "audit_commanded_work": "J",
    "work_gap": "-",
    "audit_measured_work": "J",
}


#: Which metrics are zeros and ones.
_RATES = ("success", "left_corridor", "unsafe")
#: What an episode is told by besides, in the tasks that have it.
_WHERE_THERE = ("box_size", "left_corridor", "unsafe")


@torch.no_grad()
def run_episodes(env: EnvBase, policy: Any, episodes: int) -> dict[str, np.ndarray]:
    """Run a policy deterministically and collect one row per episode.

    Every environment's first episodes are taken in turn, so short episodes are not preferred. An environment whose
    episode is over waits for the others: what the next round is drawn from does not hang on who acts.

    Args:
        env: batch-locked environment with metrics in its chain.
        policy: writes the action; its mean is taken where it is stochastic.
        episodes: how many.

    Returns:
        For each metric, ``success``, ``progress`` and ``control_steps``, an array ``(episodes,)``; ``box_size``,
        ``left_corridor`` and ``unsafe`` where there are such, and, where it is audited, the rest of
        :data:`POWER_AND_WORK`.

    Raises:
        ValueError: if ``episodes`` is below 1.
    """
    if episodes < 1:
        raise ValueError(f"episodes is {episodes}; expected at least 1.")
    rounds = math.ceil(episodes / env.numel())
    finished = []
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        for _ in range(rounds):
            finished.append(_one_round(env, policy))
    names = finished[0]
    return {name: np.concatenate([part[name] for part in finished])[:episodes] for name in names}


def _one_round(env: EnvBase, policy: Any) -> dict[str, np.ndarray]:
    """One episode of every environment."""
    tensordict = env.reset()
    rows: dict[str, np.ndarray] = {}
    waiting = torch.ones(env.batch_size, dtype=torch.bool)
    elapsed = torch.zeros(env.batch_size, dtype=torch.int64)
    while bool(waiting.any()):
        tensordict = env.step(policy(tensordict).set("_step", waiting.to(env.device)))
        following = tensordict["next"]
        ended = following["done"].squeeze(-1).cpu() & waiting
        steps = following.get("control_steps", None)
        elapsed += 1 if steps is None else steps.squeeze(-1).cpu()
        for name, value in (_episode_values(following) | {"control_steps": elapsed}).items():
            rows.setdefault(name, np.zeros(env.batch_size))[ended.numpy()] = value.cpu().numpy()[ended.numpy()]
        waiting &= ~ended
        tensordict = env.step_mdp(tensordict)
    return rows


def _episode_values(following: TensorDictBase) -> dict[str, torch.Tensor]:
    values = {name: following["metrics", name] for name in following["metrics"].keys()}
    values |= {name: following[name].float() for name in ("success", "progress")}
    values |= {name: following[name].float() for name in _WHERE_THERE if name in following.keys()}
    audit = following.get("audit", None)
    if audit is not None:
        values |= {f"audit_{name}": audit[name] for name in audit.keys()}
        booked = values["work"].clamp_min(1e-6)  # [J]
        values["work_gap"] = (values["audit_commanded_work"] - booked) / booked
    return {name: value.squeeze(-1) for name, value in values.items()}


def interval(values: np.ndarray, *, is_rate: bool) -> tuple[float, float]:
    """95 % confidence interval of a mean: Wilson's for a rate of successes, Student's otherwise.

    Args:
        values: one per episode.
        is_rate: whether they are zeros and ones.

    Returns:
        Lower and upper end.
    """
    count = len(values)
    if is_rate:
        result = stats.binomtest(round(float(values.sum())), count).proportion_ci(0.95, method="wilson")
        return float(result.low), float(result.high)
    if count < 2:
        return float(values.mean()), float(values.mean())
    half = float(stats.t.ppf(0.975, count - 1) * values.std(ddof=1) / math.sqrt(count))
    return float(values.mean()) - half, float(values.mean()) + half


def summarise(rows: dict[str, np.ndarray], names: Iterable[str] = REPORTED) -> dict[str, dict[str, Any]]:
    """Mean and 95 % interval of each metric.

    Args:
        rows: what :func:`run_episodes` returned.
        names: which metrics.

    Returns:
        ``{name: {"mean": x, "ci95": [low, high]}}``; ratios stay within [0, 1].
    """
    summary: dict[str, dict[str, Any]] = {}
    for name in names:
        low, high = interval(rows[name], is_rate=name in _RATES)
        if REPORTED.get(name) == "0-1":
            low, high = max(0.0, low), min(1.0, high)
        summary[name] = {"mean": float(rows[name].mean()), "ci95": [low, high]}
    return summary


def distribution(rows: dict[str, np.ndarray], names: Iterable[str] = POWER_AND_WORK) -> dict[str, dict[str, float]]:
    """Mean, 95th percentile and maximum over episodes; of a relative gap, those of its size.

    Args:
        rows: what :func:`run_episodes` returned for an audited environment.
        names: which quantities.

    Returns:
        ``{name: {"mean": x, "p95": x, "max": x}}``.
    """
    sizes = {name: np.abs(rows[name]) for name in names}
    return {
        name: {"mean": float(v.mean()), "p95": float(np.quantile(v, 0.95)), "max": float(v.max())}
        for name, v in sizes.items()
    }


class ZeroPolicy:
    """The reference alone: a policy whose action is zero.

    Args:
        actor: whose action's shape it takes.
    """

    def __init__(self, actor: Any) -> None:
        self._actor = actor

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write a zero action."""
        tensordict = self._actor(tensordict)
        return tensordict.set("action", torch.zeros_like(tensordict["action"]))


@torch.no_grad()
def record_episodes(env: EnvBase, policy: Any, keys: Sequence[NestedKey]) -> TensorDictBase:
    """One episode of every environment with what was observed after each of its control steps.

    Args:
        env: with or without a :class:`~ppt_rl.transforms.MacroStepTransform`; its trace is set to ``keys``.
        policy: writes the action; its mean is taken.
        keys: entries to record.

    Returns:
        The ``next`` that ended each episode, ``("trace", key)`` ``(B, T, ...)``, and ``control_steps``, how many of
        the T are of the episode.
    """
    macro = next((part for part in env.transform if isinstance(part, MacroStepTransform)), None)
    if macro is not None:
        macro.trace_keys = list(keys)
        env.empty_cache()
    chunks: list[TensorDictBase] = []
    last: TensorDictBase | None = None
    over = torch.zeros(env.batch_size, dtype=torch.bool)
    steps = torch.zeros(*env.batch_size, 1, dtype=torch.int64)
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        tensordict = env.reset()
        while last is None or not bool(over.all()):
            tensordict = env.step(policy(tensordict))
            following = tensordict["next"]
            chunks.append(following)
            last = following if last is None else following.where(~over, last)
            executed = following.get("control_steps", None)
            steps += (1 if executed is None else executed.cpu()) * ~over.unsqueeze(-1)
            over |= following["done"].reshape(env.batch_size).cpu()
            tensordict = env.step_mdp(tensordict)
    episode = last.clone(recurse=False).set("control_steps", steps)
    if macro is None:
        return episode.set("trace", {key: torch.stack([chunk[key] for chunk in chunks], 1) for key in keys})
    for key in chunks[0]["trace"].keys(True, True):
        episode.set(("trace", key), _joined(chunks, key))
    return episode


def _joined(chunks: Sequence[TensorDictBase], key: NestedKey) -> torch.Tensor:
    """Traces of chunks one after the other, ``(B, T, ...)``; what a row did not execute of a chunk is left out."""
    parts = [chunk["trace", key] for chunk in chunks]
    executed = [chunk["control_steps"].squeeze(-1) for chunk in chunks]
    full = torch.cat(parts, 1)
    there = torch.cat([torch.arange(p.shape[1]) < n.unsqueeze(-1) for p, n in zip(parts, executed, strict=True)], 1)
    order = (~there).to(torch.int8).argsort(stable=True, dim=1)  # executed steps first, in their order
    return full[torch.arange(len(full)).unsqueeze(-1), order]
