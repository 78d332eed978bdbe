"""Deterministic episodes of a policy: a row of metrics for each, or everything that was observed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torchrl.envs import Compose, EnvBase, TransformedEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type
from tqdm import tqdm

from ppt_rl.functional.argument_checks import require_whole
from ppt_rl.transforms.macro_step import MacroStepTransform

__all__ = ["Rows", "ZeroPolicy", "record_episodes", "require_run_options", "run_episodes"]

#: One value per episode, by metric.
Rows = dict[str, NDArray[Any]]


#: Largest number of episodes, whose rows are all kept in memory, of environments that step together, and largest seed.
_MOST, _MOST_ENVS, _LARGEST_SEED = 1_000_000, 16_384, 2**32 - 1


def require_run_options(*, episodes: int, seed: int = 0, num_envs: int = 1) -> None:
    """Raise unless numbers of episodes and environments and a seed are whole numbers that a machine can work off.

    Args:
        episodes: number of episodes, 1 to a million.
        seed: seed of the episodes, 0 to 2^32 - 1.
        num_envs: number of environments that step together, 1 to 16384.

    Raises:
        ValueError: if one is out of range.
    """
    require_whole("episodes", episodes, 1, _MOST)
    require_whole("seed", seed, 0, _LARGEST_SEED)
    require_whole("num_envs", num_envs, 1, _MOST_ENVS)


def _require_observed(env: EnvBase, keys: Sequence[NestedKey]) -> None:
    there = list(env.observation_spec.keys(True, True))
    missing = [key for key in keys if key not in there]
    if missing:
        raise KeyError(f"keys are {list(keys)}, of which {missing} are not observed; expected keys from {there}.")


@torch.no_grad()
def run_episodes(
    env: EnvBase, policy: Any, episodes: int, *, keys: Sequence[str] = (), progress: str | None = None
) -> Rows:
    """Run a policy deterministically and collect one row per episode.

    The first episodes of every environment are taken in turn, so short episodes are not preferred. An environment whose
    episode is over waits for the others, so the next round of episodes does not depend on who acts.

    Args:
        env: batch-locked environment with metrics in its chain.
        policy: writes the action; its mean is taken where it is stochastic.
        episodes: number of episodes.
        keys: further observations at the end of an episode to keep, ``(*B, 1)`` each.
        progress: label of a progress bar on a terminal; None shows none.

    Returns:
        For each metric, ``success``, ``progress``, ``control_steps``, ``keys`` and, where the environment is audited,
        the rest of :data:`~ppt_rl.evaluation.columns.POWER_AND_WORK`: an array ``(episodes,)``.

    Raises:
        ValueError: if ``episodes`` is out of range, or the environment writes no metrics.
        KeyError: if one of ``keys`` is not observed.
    """
    require_run_options(episodes=episodes)
    _require_observed(env, keys)
    if "metrics" not in env.observation_spec.keys():
        raise ValueError(
            "the environment writes no metrics; expected a chain with an EpisodeMetricsTransform. Append one before "
            "the macro step."
        )
    rounds = math.ceil(episodes / env.numel())
    bar = tqdm(total=rounds * env.numel(), desc=progress, unit=" episodes", disable=None if progress else True)
    with set_exploration_type(ExplorationType.DETERMINISTIC), bar:
        finished = [_one_round(env, policy, ("success", "progress", *keys), bar) for _ in range(rounds)]
    return {name: np.concatenate([part[name] for part in finished])[:episodes] for name in finished[0]}


def _one_round(env: EnvBase, policy: Any, keys: Sequence[str], bar: tqdm) -> Rows:
    """One episode of every environment."""
    tensordict = env.reset()
    rows: Rows = {}
    waiting = torch.ones(env.batch_size, dtype=torch.bool)
    elapsed = torch.zeros(env.batch_size, dtype=torch.int64)
    while bool(waiting.any()):
        tensordict = env.step(policy(tensordict).set("_step", waiting.to(env.device)))
        following = tensordict["next"]
        ended = following["done"].squeeze(-1).cpu() & waiting
        steps = following.get("control_steps", None)
        elapsed += 1 if steps is None else steps.squeeze(-1).cpu()
        for name, value in (_episode_values(following, keys) | {"control_steps": elapsed}).items():
            rows.setdefault(name, np.zeros(env.batch_size))[ended.numpy()] = value.cpu().numpy()[ended.numpy()]
        waiting &= ~ended
        bar.update(int(ended.sum()))
        tensordict = env.step_mdp(tensordict)
    return rows


def _episode_values(following: TensorDictBase, keys: Sequence[str]) -> dict[str, torch.Tensor]:
    values = {name: following["metrics", name] for name in following["metrics"].keys()}
    values |= {name: following[name].float() for name in keys}
    audit = following.get("audit", None)
    if audit is not None:
        values |= {f"audit_{name}": audit[name] for name in audit.keys()}
        metered = values["work"].clamp_min(1e-6)  # [J]
        values["work_gap"] = (values["audit_commanded_work"] - metered) / metered
    return {name: value.squeeze(-1) for name, value in values.items()}


class ZeroPolicy:
    """The reference alone: a policy whose action is zero.

    Args:
        actor: policy whose action's shape is used.
    """

    def __init__(self, actor: Any) -> None:
        self._actor = actor

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write a zero action."""
        tensordict = self._actor(tensordict)
        return tensordict.set("action", torch.zeros_like(tensordict["action"]))


@torch.no_grad()
def record_episodes(env: EnvBase, policy: Any, keys: Sequence[NestedKey]) -> TensorDictBase:
    """Record one episode of every environment: what was observed after each of its control steps.

    Args:
        env: with or without a :class:`~ppt_rl.transforms.MacroStepTransform`; its trace is set to ``keys``.
        policy: writes the action; its mean is taken.
        keys: entries to record.

    Returns:
        The ``next`` that ended each episode, ``("trace", key)`` ``(B, T, ...)``, and ``control_steps``, how many of
        the T are of the episode.

    Raises:
        KeyError: if one of ``keys`` is not observed.
    """
    _require_observed(env, keys)
    transform = env.transform if isinstance(env, TransformedEnv) else Compose()
    parts = transform if isinstance(transform, Compose) else [transform]
    macro = next((part for part in parts if isinstance(part, MacroStepTransform)), None)
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
    """Concatenated traces of chunks, ``(B, T, ...)``; steps that an environment did not execute are left out."""
    parts = [chunk["trace", key] for chunk in chunks]
    executed = [chunk["control_steps"].squeeze(-1) for chunk in chunks]
    full = torch.cat(parts, 1)
    there = torch.cat([torch.arange(p.shape[1]) < n.unsqueeze(-1) for p, n in zip(parts, executed, strict=True)], 1)
    order = (~there).to(torch.int8).argsort(stable=True, dim=1)  # executed steps first, in their order
    return full[torch.arange(len(full)).unsqueeze(-1), order]
