"""Physics options that several test files use, and a way into the worlds of whichever engine there is."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import torch

from ppt_rl.envs import EngineConfig
from ppt_rl.envs.physics import ThreadedPhysics, WarpPhysics

#: The physics of the tasks, on one thread.
ONE_THREAD = EngineConfig(num_threads=1)
#: The same, for scenes and laws that only the engine on CPU threads has.
ON_THREADS = EngineConfig(num_threads=1, name="threads")
#: A time step four times as long, for tests that do not look at contact closely.
COARSE = EngineConfig(physics_dt=0.002, num_threads=1)
#: Relative spacing of numbers in single precision.
SPACING = 2.0**-23
#: Fields of a model that Warp keeps for each world where they follow from others that are written.
_DERIVED = ("geom_rbound", "geom_aabb", "body_subtreemass", "body_invweight0", "dof_invweight0")


def on_warp() -> bool:
    """Whether an environment for which a test names no engine is stepped by MuJoCo Warp."""
    return EngineConfig().on(torch.device("cpu")) == "warp"


def bound(double: float, single: float) -> float:
    """A bound on rounding for MuJoCo, in double precision, or that for MuJoCo Warp, in single precision."""
    return single if on_warp() else double


def engine_of(env: Any) -> ThreadedPhysics | WarpPhysics:
    """The engine of an environment, out of what audits it."""
    engine = env.engine
    while not isinstance(engine, ThreadedPhysics | WarpPhysics):
        engine = engine._engine
    return engine


def model_of(env: Any, row: int) -> Any:
    """A copy of the model of one environment, with its parameters as its engine has them."""
    engine = engine_of(env)
    if isinstance(engine, ThreadedPhysics):
        return copy.copy(engine.models[row])
    model = copy.copy(engine.model)
    for name in (*engine.written, *_DERIVED):
        values = engine._open_worlds().field(name)
        field, own = getattr(model, name), values[row if len(values) > 1 else 0]
        field[:] = own.cpu().numpy().reshape(field.shape)
    if "geom_pos" in engine.written:
        model.geom_sameframe[:] = 0  # a geom that moves no longer shares the frame of its body
    return model


def models_of(env: Any) -> list[Any]:
    """Copies of the models of all environments."""
    return [model_of(env, row) for row in range(env.num_envs)]


def write_state(env: Any, row: int, entries: Any, values: Any) -> None:
    """Change entries of the physics state of one environment behind its back, numbered as in ``engine.state(row)``."""
    engine = engine_of(env)
    if isinstance(engine, ThreadedPhysics):
        engine._state[row, entries] = values
        return
    state = torch.from_numpy(engine.state(row))
    state[entries] = torch.as_tensor(np.asarray(values, dtype=np.float64))
    parts = engine._open_worlds().state[:3]
    for part, new in zip(parts, state.split([part[row].numel() for part in parts]), strict=True):
        part[row] = new.reshape(part[row].shape).to(part)
