"""A training of a second, and parts of one."""

from __future__ import annotations

import os
import signal
import sys
import traceback
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import nn

from ppt_rl.recipes.ppo_s_push import RECIPE
from ppt_rl.training import PPOConfig
from ppt_rl.training.checkpoint import save_checkpoint

BATCH = 2 * 10  # control steps of a batch: environments times steps of a batch
#: The options of :func:`tiny` on a command line.
OPTIONS = (
    "--num-envs", "2", "--num-threads", "1", "--duration", "0.1", "--physics-dt", "0.005", "--hold-steps", "1",
    "--ppo.epochs", "1", "--ppo.minibatches", "1", "--ppo.checkpoint-every", "1",
)  # fmt: skip


def tiny(run_dir: Path, batches: int = 3, *, checkpoint_every: int = 1, **changes: Any) -> Any:
    """Options of a training of so many batches."""
    ppo = PPOConfig(total_control_steps=batches * BATCH, epochs=1, minibatches=1, checkpoint_every=checkpoint_every)
    config = RECIPE.config(num_envs=2, num_threads=1, duration=0.1, physics_dt=0.005, hold_steps=1, ppo=ppo)
    return replace(config, run_dir=run_dir, **changes)


def train(run_dir: Path, batches: int = 3, **changes: Any) -> Path:
    """Train so long; the path of the last checkpoint."""
    return RECIPE.train(tiny(run_dir, batches, **changes))


def write(run_dir: Path, *steps: int, success: float = 0.0, **metadata: Any) -> list[Path]:
    """Checkpoints of a small network, without a training."""
    made = []
    for step in steps:
        net = nn.Linear(4, 3)
        nn.init.constant_(net.weight, step)
        about = {"variant": "small", "config": {"p_max": 2.0}, "success": success, **metadata}
        made.append(save_checkpoint(run_dir, {"net": net, "counters": {"step": step}}, step=step, metadata=about))
    return made


def flip(path: Path, place: int) -> None:
    """Flip the bits of one byte of a file."""
    data = bytearray(path.read_bytes())
    data[place] ^= 0xFF
    path.write_bytes(data)


def forked(work: Callable[[], Any], output: Path) -> int:
    """A child of this process, which has imported everything already; its output goes into a file."""
    child = os.fork()
    if child:
        return child
    status = 99
    try:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL if number != signal.SIGINT else signal.default_int_handler)
        with output.open("w") as file:
            os.dup2(file.fileno(), 1)
            os.dup2(file.fileno(), 2)
        sys.stdout, sys.stderr = open(1, "w", closefd=False), open(2, "w", buffering=1, closefd=False)  # noqa: SIM115
        torch.set_num_threads(1)
        work()
        status = 0
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 98
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(status)
