"""What a study keeps of a finished run: curves, every evaluated episode, summaries, recorded rollouts."""

from __future__ import annotations

import gzip
import io
import json
import shutil
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ppt_rl.evaluation.columns import COLUMNS
from ppt_rl.evaluation.episodes import record_episodes
from ppt_rl.evaluation.judge import Evaluation, evaluate, rows_of
from ppt_rl.evaluation.policy import Policy, restored_config
from ppt_rl.evaluation.recipe import Recipe
from ppt_rl.evaluation.seeds import seeds_of
from ppt_rl.evaluation.statistics import distribution
from ppt_rl.evaluation.tables import as_csv, from_csv
from ppt_rl.training import VALIDATED, CheckpointMismatch
from ppt_rl.training.logs import read_scalar, write_bytes_atomically, write_text_atomically

__all__ = ["KeptRun", "cost_csv", "curves_csv", "keep_run", "validation_csv"]

Array = NDArray[np.float64]
_Content = TypeVar("_Content")
#: What a damaged file makes its readers raise.
_UNREADABLE = (OSError, ValueError, EOFError, zlib.error, zipfile.BadZipFile)
#: What the file of an evaluation holds at least.
_JUDGED = ("episodes", "eval_seed", "groups", "summary")
#: Logged scalars that are kept.
_CURVES = (*COLUMNS, "max_power_measured", "work", "reward", "kl", "seconds")
#: Logged scalars that are kept of a training under a limit on a cost.
_COSTS = ("cost", "cost_limit", "multiplier")
#: Scalars of a validation that are kept, by their names here.
_VALIDATED = {name.removeprefix("validation_"): name for name in VALIDATED}


@dataclass(frozen=True)
class KeptRun:
    """One variant with one seed.

    Attributes:
        recipe: the variant.
        seed: seed of everything random in training.
        run_dir: directory of logs and checkpoints.
        results: directory of what is kept.
    """

    recipe: Recipe
    seed: int
    run_dir: Path
    results: Path

    @property
    def finished(self) -> bool:
        """Whether everything was kept; the summaries are written last."""
        return (self.results / "evaluation.json").exists()

    def evaluation(self) -> dict[str, Any]:
        """How the run was judged: ``episodes`` (per group), ``eval_seed``, ``groups``, ``summary`` and ``audit``.

        Raises:
            CheckpointMismatch: if it cannot be read; so do the other methods that read a file.
        """
        return _record(self.results / "evaluation.json", _JUDGED)

    def config(self) -> Any:
        """Options of the run."""
        path = self.results / "config.json"
        return restored_config(self.recipe, _record(path, ("config",))["config"], path)

    def curves(self) -> dict[str, Array]:
        """Logged scalars of every batch by name, and ``control_steps``."""
        return _read(self.results / "curves.csv", lambda data: from_csv(data.decode()))

    def validation(self) -> dict[str, Array]:
        """``control_steps``, ``success`` and ``max_power`` of every validation; empty arrays where there was none."""
        path = self.results / "validation.csv"
        if not path.exists():
            return {name: np.zeros(0) for name in ("control_steps", *_VALIDATED)}
        return _read(path, lambda data: from_csv(data.decode()))

    def actors(self) -> list[str]:
        """Who was judged: the variant first, then baselines."""
        return list(self.evaluation()["summary"])

    def episodes(self, actor: str | None = None) -> dict[str, Array]:
        """Every evaluated episode.

        Args:
            actor: a baseline; None for the policy.

        Returns:
            Arrays by metric; ``group`` is the index of the episode's group.
        """
        return _read(self._episodes_path(actor), lambda data: from_csv(gzip.decompress(data).decode()))

    def rollouts(self) -> dict[str, Array]:
        """Recorded episodes: observations ``(N, T, n)`` by name, and ``steps`` ``(N,)``, the length of each."""
        return _read(self.results / "rollouts.npz", _arrays)

    def _episodes_path(self, actor: str | None) -> Path:
        own = actor is None or actor == self.recipe.variant
        name = "episodes" if own else str(actor).replace(" ", "_")
        return self.results / f"{name}.csv.gz"

    def write_episodes(self, evaluation: Evaluation) -> None:
        """Write every evaluated episode, a compressed CSV file for each actor.

        Args:
            evaluation: rows by actor and group.
        """
        for actor, groups in evaluation.rows.items():
            rows = [row | {"group": index} for index, part in enumerate(groups.values()) for row in rows_of(part)]
            write_bytes_atomically(self._episodes_path(actor), gzip.compress(as_csv(rows).encode(), mtime=0))


def _read(path: Path, parse: Callable[[bytes], _Content]) -> _Content:
    """Content of a file of results, or an error that says what to do about it."""
    try:
        return parse(path.read_bytes())
    except _UNREADABLE as error:
        what = " ".join(str(error).split())
        raise CheckpointMismatch(
            f"{path} cannot be read ({what}); expected what a study keeps of a finished run. Remove the folder, and "
            "run the study again."
        ) from error


def _record(path: Path, needed: Sequence[str]) -> dict[str, Any]:
    """A JSON object with at least the needed entries."""
    record = _read(path, json.loads)
    missing = [name for name in needed if name not in record] if isinstance(record, dict) else list(needed)
    if missing:
        raise CheckpointMismatch(
            f"{path} lacks {missing}; expected a JSON object with {list(needed)}. Remove the folder, and run the study "
            "again."
        )
    return record


def _arrays(data: bytes) -> dict[str, Array]:
    with np.load(io.BytesIO(data)) as file:
        return {name: file[name].astype(np.float64) for name in file.files}


def keep_run(run: KeptRun, policy: Policy, *, episodes: int, seed: int | Sequence[int], num_envs: int) -> None:
    """Judge a trained policy in each group of episodes and keep the results; with seed 0 the baselines as well.

    Args:
        run: the run.
        policy: its policy.
        episodes: number of episodes in each group.
        seed: seed of the episodes, or several, which share them equally.
        num_envs: number of environments that step together.
    """
    baselines = run.seed == 0 and run.recipe.has_reference
    evaluation = evaluate(
        policy, episodes=episodes, seed=seed, num_envs=num_envs, groups=True, baselines=baselines, everything=False
    )
    run.write_episodes(evaluation)
    write_bytes_atomically(run.results / "rollouts.npz", _recorded(policy, seeds_of(seed)[0]))
    write_text_atomically(run.results / "curves.csv", curves_csv(run.run_dir))
    if run.recipe.make_constraint is not None:
        write_text_atomically(run.results / "cost.csv", cost_csv(run.run_dir))
    if policy.config.validate_every:
        write_text_atomically(run.results / "validation.csv", validation_csv(run.run_dir))
    shutil.copyfile(run.run_dir / "config.json", run.results / "config.json")
    rows = evaluation.rows
    record = {
        "variant": run.recipe.variant, "seed": run.seed, "episodes": episodes,
        "eval_seed": seed if isinstance(seed, int) else list(seed),
        "groups": list(rows[run.recipe.variant]),
        "summary": {a: {group: evaluation.summary(a, group) for group in part} for a, part in rows.items()},
        "audit": {a: {group: distribution(part[group]) for group in part} for a, part in rows.items()},
    }  # fmt: skip
    write_text_atomically(run.results / "evaluation.json", json.dumps(record, indent=2) + "\n")


def curves_csv(run_dir: Path) -> str:
    """Logged scalars as CSV, a row for each batch in which episodes ended.

    Args:
        run_dir: directory of a trained run.

    Returns:
        The text.
    """
    return _scalars_csv(run_dir, {name: name for name in _CURVES})


def cost_csv(run_dir: Path) -> str:
    """The mean cost of an episode, its limit and the multiplier as CSV, a row for each batch in which episodes ended.

    Args:
        run_dir: directory of a run that was trained under a limit on a cost.

    Returns:
        The text.
    """
    return _scalars_csv(run_dir, {name: name for name in _COSTS})


def validation_csv(run_dir: Path) -> str:
    """Scalars of the validations as CSV, a row for each.

    Args:
        run_dir: directory of a trained run.

    Returns:
        The text.
    """
    return _scalars_csv(run_dir, _VALIDATED)


def _scalars_csv(run_dir: Path, names: Mapping[str, str]) -> str:
    """Logged scalars by the names they get: a row for each step of the first one."""
    table = {name: dict(zip(*read_scalar(run_dir, logged), strict=True)) for name, logged in names.items()}
    steps = next(iter(table.values()))
    return as_csv([{"control_steps": step, **{name: values[step] for name, values in table.items()}} for step in steps])


def _recorded(policy: Policy, seed: int) -> bytes:
    """Episodes of the task's choice as a compressed archive of arrays."""
    pictures = policy.recipe.task.pictures
    env = policy.make_env(pictures.rollouts, seed=seed, privileged=True, given=pictures.given())
    episodes = record_episodes(env, policy.actor, policy.recipe.traced)
    env.close()
    arrays = {key: value.numpy() for key, value in episodes["trace"].items()}
    arrays = {key: value.astype(np.float32) if value.dtype.kind == "f" else value for key, value in arrays.items()}
    arrays["steps"] = episodes["control_steps"].squeeze(-1).numpy()
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()
