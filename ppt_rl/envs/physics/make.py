"""The engine that an environment's options ask for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch

from ppt_rl.envs.physics.base import PhysicsEngine
from ppt_rl.envs.physics.config import EngineConfig
from ppt_rl.envs.physics.threads import ThreadedPhysics
from ppt_rl.envs.physics.warp import WarpPhysics

__all__ = ["make_engine"]


def make_engine(
    config: EngineConfig,
    model: Any,
    num_envs: int,
    substeps: int,
    device: torch.device,
    *,
    written: Sequence[str],
    every_substep: bool,
) -> PhysicsEngine:
    """Make an engine.

    Args:
        config: options of the physics.
        model: compiled model.
        num_envs: number of environments.
        substeps: physics steps in a control step.
        device: device of what the environment returns.
        written: fields of the model that differ between environments.
        every_substep: whether the readings of every substep are needed.

    Returns:
        The engine. Its own device is ``device`` for ``warp``, and the CPU for ``threads``.

    Raises:
        ImportError: if the engine is not installed.
    """
    if config.on(device) == "threads":
        return ThreadedPhysics(model, num_envs, substeps, config.num_threads)
    return WarpPhysics(
        model, num_envs, substeps, device, written=written, contacts=config.contacts, every_substep=every_substep
    )
