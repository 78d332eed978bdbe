"""MuJoCo on a native thread pool: ``mujoco.rollout`` with one model for each environment."""

from __future__ import annotations

import copy
import os
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from mujoco import rollout
from numpy.typing import NDArray
from torch import Tensor

from ppt_rl.envs.mujoco_imports import mujoco
from ppt_rl.envs.physics.base import PhysicsStep
from ppt_rl.envs.physics.parameters import Parameter, write_models

__all__ = ["ThreadedPhysics"]

Array = NDArray[np.float64]
_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS


class ThreadedPhysics:
    """An engine on CPU threads, which run without Python's global interpreter lock.

    A copy (``copy.deepcopy``, ``pickle``) is an engine of its own in the same state; that of a closed one is closed.

    Args:
        model: compiled model; every environment gets a copy.
        num_envs: number of environments.
        substeps: physics steps in a control step.
        num_threads: threads of the pool; None takes one for each CPU that this process may use. The number never
            changes a result.
    """

    device = torch.device("cpu")

    def __init__(self, model: Any, num_envs: int, substeps: int, num_threads: int | None = None) -> None:
        self.num_envs = num_envs
        self.substeps = substeps
        self.num_threads = min(num_envs, num_threads or len(os.sched_getaffinity(0)))
        self.models: list[Any] = [copy.copy(model) for _ in range(num_envs)]
        self._state = np.zeros((num_envs, mujoco.mj_stateSize(model, _STATE)))
        self._start()

    def _start(self) -> None:
        """Start the threads and allocate what holds nothing from one call to the next."""
        model, shape = self.models[0], (self.num_envs, self.substeps)
        self._dt = model.opt.timestep
        self._data = [mujoco.MjData(model) for _ in range(max(1, self.num_threads))]
        # The pool does not count the calling thread, so one thread in all means no pool.
        self._pool = rollout.Rollout(nthread=self.num_threads if self.num_threads > 1 else 0)
        self._states = np.zeros((*shape, self._state.shape[-1]))
        self._sensors = np.zeros((*shape, model.nsensordata))
        self._control = np.zeros((*shape, model.nu))

    def write(self, rows: Tensor, parameters: Sequence[Parameter]) -> None:
        """See :meth:`PhysicsEngine.write`."""
        write_models([self.models[row] for row in rows.tolist()], parameters, rows.tolist())

    def reset(self, rows: Tensor, position: Tensor) -> Tensor:
        """See :meth:`PhysicsEngine.reset`."""
        data = self._data[0]
        sensors = np.empty((len(rows), self._sensors.shape[-1]))
        for k, (row, start) in enumerate(zip(rows.tolist(), position.numpy(), strict=True)):
            model = self.models[row]
            mujoco.mj_setConst(model, data)  # recompute the constants that follow from masses and sizes
            mujoco.mj_resetData(model, data)
            data.qpos[:] = start
            mujoco.mj_forward(model, data)
            mujoco.mj_getState(model, data, self._state[row], _STATE)
            sensors[k] = data.sensordata
        return torch.from_numpy(sensors)

    def step(self, control: Tensor, mask: Tensor | None = None) -> PhysicsStep:
        """See :meth:`PhysicsEngine.step`."""
        if mask is None:
            return PhysicsStep(torch.from_numpy(self._sensors), torch.from_numpy(self._roll(control.numpy())))
        rows = mask.nonzero().squeeze(-1).numpy()
        diverged = np.zeros(self.num_envs, dtype=bool)
        if len(rows):
            diverged[rows] = self._roll(control.numpy()[rows], rows)
            self._sensors[rows] = self._sensors[: len(rows)].copy()
        return PhysicsStep(torch.from_numpy(self._sensors), torch.from_numpy(diverged))

    def _roll(self, control: Array, rows: NDArray[np.int64] | None = None) -> NDArray[np.bool_]:
        """Advance the states of ``rows``, with their readings in the first rows of the buffer; which ones diverged."""
        count = self.num_envs if rows is None else len(rows)
        models = self.models if rows is None else [self.models[row] for row in rows]
        before = self._state if rows is None else self._state[rows]
        states, sensors, held = self._states[:count], self._sensors[:count], self._control[:count]
        held[:] = control[:, None]
        self._pool.rollout(
            models, self._data, before, held, nstep=self.substeps, state=states, sensordata=sensors, skip_checks=True
        )
        after = states[:, -1]
        # MuJoCo resets a state that blows up together with its clock, so a wrong time reveals it.
        late = np.abs(after[:, 0] - before[:, 0] - self.substeps * self._dt) > 0.5 * self._dt
        finite = np.isfinite(after).all(-1) & np.isfinite(sensors[:, -1]).all(-1)
        diverged: NDArray[np.bool_] = late | ~finite
        if diverged.any():
            after = np.where(diverged[:, None], before, after)
        if rows is None:
            self._state[:] = after
        else:
            self._state[rows] = after
        return diverged

    def state(self, row: int) -> Array:
        """See :meth:`PhysicsEngine.state`."""
        return self._state[row].copy()

    def close(self) -> None:
        """Stop the threads."""
        self._pool.close()
        self._pool = None

    def __getstate__(self) -> dict[str, Any]:
        """What a copy takes along: the models with their parameters and the states, but no thread."""
        kept = ("num_envs", "substeps", "num_threads", "models", "_state")
        return {name: getattr(self, name) for name in kept} | {"open": self._pool is not None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Continue from the models and states of another engine, on threads of its own."""
        is_open = state.pop("open")
        self.__dict__.update(state)
        self._pool = None
        if is_open:
            self._start()
