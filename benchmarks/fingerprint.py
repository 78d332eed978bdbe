"""Whether a change of the code changes any result, bit by bit.

Digests of what every published policy does in fixed episodes, and of the first batches of every training. Write them
before the change and compare after it, on the same machine:

``python benchmarks/fingerprint.py --write before.json`` and ``python benchmarks/fingerprint.py --compare before.json``
"""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from ppt_rl.evaluation import find_recipe, load_policy, published_policies, run_episodes, shipped_recipes
from ppt_rl.training import run_script
from ppt_rl.training.logs import RunLogs


@dataclass(frozen=True)
class Config:
    """Write or compare digests of results.

    Attributes:
        write: file to write the digests to.
        compare: file of digests to compare with.
        episodes: number of episodes of each published policy.
        seed: seed of the episodes.
        batches: number of batches of each training; 0 trains nothing.
    """

    write: Path | None = None
    compare: Path | None = None
    episodes: int = 32
    seed: int = 10_000
    batches: int = 3

    def __post_init__(self) -> None:
        """Refuse a run without a purpose."""
        if (self.write is None) == (self.compare is None):
            raise ValueError(f"--write is {self.write} and --compare is {self.compare}; expected exactly one of them.")


def of_policy(name: str, run: Config) -> dict[str, str]:
    """Digests of every metric of a published policy."""
    policy = load_policy(name)
    env = policy.make_env(run.episodes, seed=run.seed, audit=True)
    rows = run_episodes(env, policy.actor, run.episodes, keys=policy.recipe.task.report.episode_keys, progress=name)
    env.close()
    return {metric: _digest(np.ascontiguousarray(values).tobytes()) for metric, values in rows.items()}


class _Enough(Exception):
    """Raised when enough batches are logged."""


def of_training(variant: str, run: Config) -> dict[str, str]:
    """Digests of every logged scalar but the time, over the first batches of a training."""
    recipe = find_recipe(variant)
    write, lines = RunLogs.write, []

    def counted(logs: RunLogs, scalars: Mapping[str, float], step: int) -> None:
        lines.append({name: value for name, value in scalars.items() if name != "seconds"} | {"step": step})
        if len(lines) == run.batches:
            raise _Enough
        write(logs, scalars, step)

    RunLogs.write = counted  # type: ignore[method-assign,assignment]
    try:
        with tempfile.TemporaryDirectory() as folder, suppress(_Enough):
            recipe.train(replace(recipe.config(), run_dir=Path(folder) / variant))
    finally:
        RunLogs.write = write  # type: ignore[method-assign]
    names = sorted({name for line in lines for name in line})
    return {name: _digest(json.dumps([line.get(name) for line in lines]).encode()) for name in names}


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]


def measure(run: Config) -> dict[str, dict[str, str]]:
    """Digests by policy and by training."""
    digests = {f"policy {name}": of_policy(name, run) for name in published_policies()}
    if run.batches:
        digests |= {f"training {variant}": of_training(variant, run) for variant in shipped_recipes()}
    return digests


def main(run: Config) -> None:
    """Write or compare."""
    torch.set_num_threads(1)
    digests = measure(run)
    if run.write is not None:
        run.write.write_text(json.dumps(digests, indent=2) + "\n")
        return
    assert run.compare is not None
    before, changed = json.loads(run.compare.read_text()), 0
    for name, now in digests.items():
        old = before.get(name, {})
        differing = sorted(key for key in old.keys() | now.keys() if old.get(key) != now.get(key))
        changed += bool(differing)
        print(f"{name}: {'the same to the bit' if not differing else f'differs in {differing}'}")
    raise SystemExit(1 if changed else 0)


if __name__ == "__main__":
    run_script(main, Config)
