"""MuJoCo Warp: all environments as worlds of one simulation on a device, a control step as one captured graph."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ppt_rl.envs.mujoco_imports import mujoco
from ppt_rl.envs.physics.base import PhysicsStep
from ppt_rl.envs.physics.parameters import Parameter, ids_of
from ppt_rl.envs.physics.warp_worlds import Worlds

__all__ = ["WarpPhysics"]


class WarpPhysics:
    """An engine on one device, in single precision; a control step neither leaves the device nor waits for it.

    On a GPU the substeps of a control step are one CUDA graph, recorded at the second step. On the CPU the same kernels
    run one after the other, on one thread: for tests, not for speed.

    A world diverges where its state is beyond the bounds of MuJoCo (a position, velocity or acceleration above 1e10),
    its readings or its control are not finite, or its contacts or constraints have exceeded their room. It keeps the
    state it had before the step, and no other world notices. The contacts of all worlds share one memory, though: where
    they together need more than twice their room, every world diverges.

    A copy (``copy.deepcopy``, ``pickle``) is an engine of its own in the same state; that of a closed one is closed.

    Args:
        model: compiled model.
        num_envs: number of worlds.
        substeps: physics steps in a control step.
        device: where the worlds live.
        written: fields of the model that differ between worlds, see :class:`Parameter`; no other one can be written.
        contacts: room for contacts, for each world.
        every_substep: whether the readings of every substep are kept, or only those of the last one.

    Raises:
        ImportError: if MuJoCo Warp is not installed.
        ValueError: if a written field cannot differ between worlds.
    """

    def __init__(
        self,
        model: Any,
        num_envs: int,
        substeps: int,
        device: torch.device,
        *,
        written: Sequence[str] = (),
        contacts: int = 24,
        every_substep: bool = False,
    ) -> None:
        self.num_envs, self.substeps, self.device = num_envs, substeps, device
        self.model, self.written, self.contacts, self.every_substep = model, tuple(written), contacts, every_substep
        self._start()

    def _start(self) -> None:
        """Put the model on the device, and allocate what a step needs."""
        self.worlds: Worlds | None = Worlds(self.model, self.num_envs, self.device, self.written, self.contacts)
        count = self.substeps if self.every_substep else 1
        self._record = self.worlds.sensors.new_zeros(count, *self.worlds.sensors.shape)
        self._sensors = self._record.transpose(0, 1)
        self._graphs: dict[str, Any] = {}

    # -- PhysicsEngine ------------------------------------------------------------------------------------------------

    def write(self, rows: Tensor, parameters: Sequence[Parameter]) -> None:
        """See :meth:`PhysicsEngine.write`.

        Raises:
            ValueError: if a field was not named as one that is written.
        """
        worlds = self._open_worlds()
        for parameter in parameters:
            if parameter.field not in self.written:
                raise ValueError(
                    f"{parameter.field} is not among the fields that differ between worlds, {list(self.written)}; "
                    "expected one of them. Name it among the fields that the environment writes."
                )
            field = worlds.field(parameter.field)
            ids = torch.from_numpy(ids_of(self.model, parameter)).to(self.device)
            values = parameter.values[rows].to(field)
            if field.ndim == 2:
                field[rows.unsqueeze(-1), ids] = values
            else:
                field[rows.unsqueeze(-1), ids, : values.shape[-1]] = values

    def reset(self, rows: Tensor, position: Tensor) -> Tensor:
        """See :meth:`PhysicsEngine.reset`."""
        worlds = self._open_worlds()
        worlds.derive()
        worlds.place(rows, position)
        self._run("forward", worlds.forward)
        return worlds.sensors[rows].clone()

    def step(self, control: Tensor, mask: Tensor | None = None) -> PhysicsStep:
        """See :meth:`PhysicsEngine.step`. A world whose control is not finite diverges."""
        worlds = self._open_worlds()
        before = [state.clone() for state in worlds.state]
        finite = control.isfinite().all(-1)
        worlds.control.copy_(torch.where(finite.unsqueeze(-1), control, 0.0))
        self._run("control step", self._substeps)
        good = finite & worlds.is_sound() & self._sensors[:, -1].isfinite().all(-1)
        stays = ~good if mask is None else ~(good & mask)
        for state, old in zip(worlds.state, before, strict=True):
            state.copy_(torch.where(stays.reshape(-1, *(1,) * (state.ndim - 1)), old, state))
        worlds.overflow.zero_()
        return PhysicsStep(self._sensors, ~good if mask is None else ~good & mask)

    def state(self, row: int) -> NDArray[np.float64]:
        """See :meth:`PhysicsEngine.state`."""
        worlds, data = self._open_worlds(), mujoco.MjData(self.model)
        data.time, data.qpos[:], data.qvel[:] = (value[row].cpu().double().numpy() for value in worlds.state[:3])
        kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
        state = np.empty(mujoco.mj_stateSize(self.model, kind))
        mujoco.mj_getState(self.model, data, state, kind)
        return state

    def close(self) -> None:
        """Free the worlds."""
        self.worlds, self._graphs = None, {}

    # -- graphs -------------------------------------------------------------------------------------------------------

    def _substeps(self) -> None:
        """The substeps of a control step; readings that nobody looks at are not computed."""
        worlds, last = self._open_worlds(), self.substeps - 1
        for index in range(self.substeps):
            read = self.every_substep or index == last
            worlds.step(with_sensors=read)
            if read:
                worlds.copy_sensors(self._record[index if self.every_substep else 0])

    def _run(self, name: str, work: Callable[[], None]) -> None:
        """Do some work on the current stream of torch, from the second time on as a recorded graph.

        The first time compiles the kernels and allocates what they keep, which a graph cannot hold.
        """
        worlds = self._open_worlds()
        if name not in self._graphs:
            self._graphs[name] = None
            with worlds.on_stream():
                work()
            return
        if self._graphs[name] is None:
            self._graphs[name] = worlds.record(work)
        worlds.replay(self._graphs[name])

    def _open_worlds(self) -> Worlds:
        if self.worlds is None:
            raise RuntimeError("the physics engine is closed; expected an open one. Make a new environment.")
        return self.worlds

    # -- copies -------------------------------------------------------------------------------------------------------

    def __getstate__(self) -> dict[str, Any]:
        """What a copy takes along: the model, the written fields and the states, on the CPU, but no graph."""
        kept = ("num_envs", "substeps", "device", "model", "written", "contacts", "every_substep")
        worlds = None if self.worlds is None else self.worlds.snapshot()
        return {name: getattr(self, name) for name in kept} | {"snapshot": worlds}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Continue from the parameters and states of another engine, in worlds of its own."""
        snapshot = state.pop("snapshot")
        self.__dict__.update(state)
        self.worlds, self._graphs = None, {}
        if snapshot is not None:
            self._start()
            self._open_worlds().restore(snapshot)
