"""Whether trainings survive being killed: at random times, and inside the writes of their checkpoints.

``python benchmarks/kills.py`` kills a hundred tiny trainings (SIGKILL), half of them inside the write of a checkpoint,
the first one of a run included, and goes on with each. It ends with status 1 unless all of them go on, none loses more
than one checkpoint interval, and every log holds each step once. Some minutes on one core; POSIX only.

Each run is killed several times in a row before it may end. A process is forked from one that has imported everything.
"""

from __future__ import annotations

import os
import random
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from ctypes import Array, c_longlong
from dataclasses import dataclass, field, replace
from functools import partial
from multiprocessing.sharedctypes import RawArray
from pathlib import Path
from types import FrameType
from typing import Any

import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator  # type: ignore[import-untyped]

from ppt_rl.recipes.ppo_s_push import RECIPE
from ppt_rl.training import VALIDATED, PPOConfig, progress, run_script
from ppt_rl.training.checkpoint import all_checkpoints
from ppt_rl.training.logs import RunLogs, read_scalar

Shared = Array[c_longlong]
#: Control steps of a batch: environments times steps of a batch.
BATCH = 2 * 10
#: Batches from one validation to the next.
_VALIDATE = 2
#: Number of checkpoints that a life may write before it is killed in the next one.
_WRITES = 3


@dataclass(frozen=True)
class Config:
    """Kill trainings and go on with them.

    Attributes:
        kills: number of kills.
        lives: number of kills of a run before it may end.
        seed: seed of the times of the kills.
    """

    kills: int = 100
    lives: int = 10
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse a measurement of nothing."""
        if self.kills < 1 or self.lives < 1:
            raise ValueError(f"kills is {self.kills} and lives is {self.lives}; expected at least 1 of each.")


@dataclass
class Result:
    """What became of the kills.

    Attributes:
        in_writes: kills inside the write of a checkpoint.
        first_writes: those of them in the first write of a run.
        lost: batches learnt and lost, for each time that a run went on.
        faults: what went wrong, in words.
    """

    in_writes: int = 0
    first_writes: int = 0
    lost: list[int] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)


def shared() -> Shared:
    """Numbers that a process shares with its children, in control steps: where a life began, and what is learnt."""
    return RawArray(c_longlong, [-1, 0])


def train(run_dir: Path, budget: int, resume: bool) -> None:
    """A tiny training that writes a checkpoint after each batch."""
    ppo = PPOConfig(total_control_steps=budget, epochs=1, minibatches=1, checkpoint_every=1)
    tiny = RECIPE.config(
        num_envs=2, num_threads=1, duration=0.1, physics_dt=0.005, hold_steps=1, validate_every=_VALIDATE, ppo=ppo
    )
    RECIPE.train(replace(tiny, run_dir=run_dir, resume=resume))


def watch(steps: Shared) -> None:
    """Report where this life goes on, and each batch that it has learnt."""
    begin, learn = RunLogs.__init__, progress.Progress.learn

    def began(logs: RunLogs, run_dir: Path, last_step: int = 0, **options: Any) -> None:
        begin(logs, run_dir, last_step, **options)
        steps[:] = [last_step, last_step]

    def learnt(self: progress.Progress, batch: Any) -> dict[str, float]:
        scalars = learn(self, batch)
        steps[1] = self.control_steps
        return scalars

    RunLogs.__init__ = began  # type: ignore[method-assign,assignment]
    progress.Progress.learn = learnt  # type: ignore[method-assign]


def in_write(write: int, call: int, kill: Callable[[int], None]) -> None:
    """Let a write of a checkpoint (0: the next) call ``kill`` at a function call inside it, or at its end."""
    save, writes = progress.save_checkpoint, 0

    def saved(*args: Any, **kwargs: Any) -> Path:
        nonlocal writes
        calls, writes = 0, writes + 1

        def count(frame: FrameType, event: str, arg: object) -> None:
            nonlocal calls
            calls += event in ("call", "c_call")
            if calls == call:
                kill(calls)

        if writes <= write:
            return save(*args, **kwargs)
        sys.setprofile(count)
        path = save(*args, **kwargs)
        sys.setprofile(None)
        kill(calls)
        return path

    progress.save_checkpoint = saved


def fork(work: Callable[[], None], log: Path) -> int:
    """A child that does some work; it ends with status 0, or with 1 and a traceback in its log. Returns its number."""
    child = os.fork()
    if child:
        return child
    try:
        with log.open("w") as file:
            os.dup2(file.fileno(), 1)
            os.dup2(file.fileno(), 2)
        work()
        os._exit(0)
    except BaseException:
        traceback.print_exc()
    os._exit(1)


def measure(folder: Path) -> tuple[float, int]:
    """Seconds of a life of a few batches, and function calls in a write of a checkpoint."""
    calls, began = shared(), time.perf_counter()

    def work() -> None:
        in_write(_WRITES - 1, -1, lambda count: calls.__setitem__(1, count))
        train(folder / "run", _WRITES * BATCH, resume=False)

    if os.waitpid(fork(work, folder / "log"), 0)[1]:
        raise RuntimeError(f"a training that is not killed fails:\n{(folder / 'log').read_text()}")
    return time.perf_counter() - began, calls[1]


def live(run_dir: Path, steps: Shared, work: Callable[[], None], delay: float | None, result: Result) -> bool:
    """One life of a run; counts what was lost when it went on. Returns whether it was killed."""
    before, steps[0] = steps[1], -1  # -1: it has not begun
    log = run_dir.with_suffix(".log")
    child = fork(work, log)
    if delay is not None:
        time.sleep(delay)
        os.kill(child, signal.SIGKILL)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if steps[0] >= 0:
        result.lost.append((before - steps[0]) // BATCH)
    if status not in (0, -signal.SIGKILL):
        result.faults.append(f"{run_dir.name} does not go on:\n{log.read_text()}")
    return status == -signal.SIGKILL


def endure(run_dir: Path, lives: int, seconds: float, calls: int, result: Result) -> None:
    """Kill a run several times, then let it end, and look at what it left."""
    steps = shared()

    def work(budget: int, resume: bool, write: int | None = None, call: int = 0) -> None:
        watch(steps)
        if write is not None:
            in_write(write, call, lambda count: os.kill(os.getpid(), signal.SIGKILL))
        train(run_dir, budget, resume)

    for life in range(lives):
        write = None if life % 2 else random.randrange(_WRITES) if life else 0
        resume = bool(all_checkpoints(run_dir)) or random.random() < 0.5  # both begin where there is no checkpoint
        doomed = partial(work, 10**9, resume, write, random.randint(1, calls))
        delay = random.uniform(0.0, seconds) if write is None else None
        killed = live(run_dir, steps, doomed, delay, result)
        result.in_writes += killed and write is not None
        result.first_writes += killed and life == 0
    budget = steps[1] + 2 * BATCH
    live(run_dir, steps, partial(work, budget, True), None, result)
    result.faults += [f"{run_dir.name}: {fault}" for fault in found_faults(run_dir, budget)]


def found_faults(run_dir: Path, last: int) -> list[str]:
    """What is wrong with a run that has ended: logs, checkpoints, leftovers."""
    faults: list[str] = []
    if not (run_dir / "logs" / "tensorboard").is_dir():
        return ["it has no logs"]
    events = EventAccumulator(str(run_dir / "logs" / "tensorboard"), size_guidance={"scalars": 0})
    events.Reload()
    for path in (run_dir / "logs" / "csv" / "scalars").iterdir():
        every = range(0, last + 1, _VALIDATE * BATCH) if path.stem in VALIDATED else range(BATCH, last + 1, BATCH)
        expected = list(every)
        in_csv = read_scalar(run_dir, path.stem)[0].tolist()
        in_events = [event.step for event in events.Scalars(path.stem)]
        if in_csv != expected or in_events != expected:
            faults.append(f"{path.stem} has the steps {in_csv} in CSV and {in_events} in TensorBoard, not {expected}")
    left = [path.name for path in run_dir.rglob(".*") if path.name != ".lock"]
    if left:
        faults.append(f"{left} are left over")
    return faults


def main(config: Config) -> None:
    """Kill, go on, report."""
    torch.set_num_threads(1)
    random.seed(config.seed)
    result, started = Result(), time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        (measured := Path(folder) / "measured").mkdir()
        seconds, calls = measure(measured)
        left, number = config.kills, 0
        while left:
            lives = min(config.lives, left)
            endure(Path(folder) / f"run{number}", lives, 2 * seconds, calls, result)
            left, number = left - lives, number + 1
    report(config, result, time.perf_counter() - started)


def report(config: Config, result: Result, seconds: float) -> None:
    """Print what became of the kills; ends with status 1 where a run did not survive."""
    print(
        f"{config.kills} kills in {seconds:.0f} s: {result.in_writes} inside the write of a checkpoint "
        f"({result.first_writes} in the first of a run), {config.kills - result.in_writes} at other times\n"
        f"batches lost: at most {max(result.lost)} (checkpoint interval: 1), mean over "
        f"{len(result.lost)} lives {sum(result.lost) / len(result.lost):.2f}\n"
        f"faults (a run that does not go on, a step missing or twice in a log, leftovers): {len(result.faults)}"
    )
    for fault in result.faults:
        print(fault)
    raise SystemExit(1 if result.faults or max(result.lost) > 1 else 0)


if __name__ == "__main__":
    run_script(main, Config)
