"""The worlds of MuJoCo Warp as torch tensors that share their memory."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from functools import cache
from typing import Any

import torch
from torch import Tensor

from ppt_rl.envs.mujoco_imports import mujoco
from ppt_rl.functional.rotations import quat_to_matrix

__all__ = ["Worlds", "import_warp"]

#: Fields that follow from a written field and are computed anew at a reset, so that each world needs its own.
_DERIVED = {
    "geom_size": ("geom_rbound", "geom_aabb"),
    "body_mass": ("body_subtreemass", "body_invweight0", "dof_invweight0"),
    "body_inertia": ("body_invweight0", "dof_invweight0"),
    "body_ipos": ("body_invweight0", "dof_invweight0"),
    "body_iquat": ("body_invweight0", "dof_invweight0"),
}
#: Rows of constraints that a contact may need: a normal and two tangential ones (``condim="3"``).
_ROWS_OF_CONTACT = 3
#: All worlds share the memory of their contacts; its size is this many times what they may need.
_SPARE = 2


@cache
def import_warp() -> tuple[Any, Any]:
    """Warp and MuJoCo Warp, without Warp's greeting.

    Returns:
        The modules.

    Raises:
        ImportError: if they are not installed.
    """
    try:
        import warp

        warp.config.log_level = warp.LOG_WARNING
        import mujoco_warp

        warp.init()
    except ImportError as error:
        raise ImportError(
            f"engine='warp' needs MuJoCo Warp, which cannot be imported ({error}). Install it with "
            "pip install 'ppt_rl[gpu]', or use engine='threads', which runs on the CPU."
        ) from error
    return warp, mujoco_warp


class Worlds:
    """A model with per-world fields and the data of all worlds.

    Args:
        model: ``mujoco.MjModel``.
        num_worlds: number of worlds.
        device: where they live.
        written: fields that differ between worlds.
        contacts: room for contacts, for each world.

    Attributes:
        state: time ``(B,)``, positions ``(B, nq)``, velocities ``(B, nv)`` and the solver's starting point ``(B, nv)``.
        control: ``(B, nu)`` inputs of the actuators.
        sensors: ``(B, S)`` readings.
        overflow: ``(B,)`` bits of what exceeded its room.

    Raises:
        ValueError: if a written field cannot differ between worlds.
    """

    def __init__(
        self, model: Any, num_worlds: int, device: torch.device, written: Sequence[str], contacts: int
    ) -> None:
        self._wp, self._mjw = import_warp()
        self._device, self.written = device, tuple(written)
        model = copy.copy(model)
        if "geom_pos" in written or "geom_quat" in written:
            model.geom_sameframe[:] = 0  # a geom that moves no longer shares the frame of its body
        fields = {*written, *(name for field in written for name in _DERIVED.get(field, ()))}
        rows = _ROWS_OF_CONTACT * contacts + int(model.jnt_limited.sum())
        with self.on_stream():
            self._model = self._mjw.put_model(model, batch_sizes=dict.fromkeys(sorted(fields), num_worlds))
            self._model.opt.warn_overflow = False  # an overflow is an event of its world, not a message
            self._model.opt.disableflags |= self._superfluous(model)
            self._data = self._mjw.make_data(model, nworld=num_worlds, nconmax=_SPARE * contacts, njmax=rows)
        data, view = self._data, self._wp.to_torch
        self.state = [view(value) for value in (data.time, data.qpos, data.qvel, data.qacc_warmstart)]
        self.control, self.sensors, self.overflow = view(data.ctrl), view(data.sensordata), view(data.overflow)
        self._derived = any(field in _DERIVED for field in written)
        self._masses = any(field.startswith("body_") for field in written)
        moved = "geom_pos" in written or "geom_quat" in written
        fixed = model.geom_bodyid == 0 if moved else []
        self._fixed = torch.as_tensor(fixed, device=device).nonzero().squeeze(-1)
        self._lost = self._bits_of_loss()

    def _superfluous(self, model: Any) -> int:
        """Flags that leave out what no joint or tendon has. MuJoCo does so by itself, but Warp launches its kernels."""

        def everywhere_zero(*fields: str) -> bool:
            return not any(getattr(model, field).any() or field in self.written for field in fields)

        kinds, off = self._mjw.DisableBit, 0
        if everywhere_zero("dof_damping", "dof_dampingpoly"):
            off |= int(kinds.EULERDAMP)
        if everywhere_zero("dof_frictionloss", "tendon_frictionloss"):
            off |= int(kinds.FRICTIONLOSS)
        return off

    def _bits_of_loss(self) -> int:
        """The kinds of overflow that make a step wrong; a solver that stops early does not."""
        kinds = self._mjw.OverflowType
        return int(kinds.ALL & ~(kinds.ITERATIONS | kinds.LS_ITERATIONS))

    # -- streams and graphs -------------------------------------------------------------------------------------------

    def _stream(self) -> Any:
        """Warp's handle of the current stream of torch; None on the CPU."""
        if self._device.type == "cpu":
            return None
        return self._wp.stream_from_torch(torch.cuda.current_stream(self._device))

    def on_stream(self) -> AbstractContextManager[Any]:
        """Make Warp launch on the device and the current stream of torch, so that both keep their order."""
        return self._wp.ScopedDevice("cpu") if self._device.type == "cpu" else self._wp.ScopedStream(self._stream())

    def record(self, work: Callable[[], None]) -> Any:
        """Record launches of Warp as a graph, without executing them on a GPU.

        Args:
            work: launches kernels whose modules are loaded.

        Returns:
            The graph.
        """
        if self._device.type == "cpu":
            return work
        current, side = torch.cuda.current_stream(self._device), torch.cuda.Stream(self._device)
        side.wait_stream(current)  # the stream that torch starts with cannot be recorded
        stream = self._wp.stream_from_torch(side)
        with self._wp.ScopedStream(stream), self._wp.ScopedCapture(stream=stream, force_module_load=False) as capture:
            work()
        current.wait_stream(side)
        return capture.graph

    def replay(self, graph: Any) -> None:
        """Execute a graph of :meth:`record`.

        Args:
            graph: the graph.
        """
        if self._device.type == "cpu":
            with self.on_stream():
                graph()
        else:
            self._wp.capture_launch(graph, stream=self._stream())

    # -- physics ------------------------------------------------------------------------------------------------------

    def step(self, *, with_sensors: bool) -> None:
        """One physics step.

        Args:
            with_sensors: whether the readings at its beginning are computed.
        """
        options, off = self._model.opt, int(self._mjw.DisableBit.SENSOR)
        options.disableflags = options.disableflags & ~off if with_sensors else options.disableflags | off
        self._mjw.step(self._model, self._data)

    def forward(self) -> None:
        """Readings of the present states."""
        options, off = self._model.opt, int(self._mjw.DisableBit.SENSOR)
        options.disableflags &= ~off
        self._mjw.forward(self._model, self._data)

    def copy_sensors(self, target: Tensor) -> None:
        """Copy the readings in a way that a graph can hold.

        Args:
            target: ``(B, S)`` contiguous tensor in single precision.
        """
        self._wp.copy(self._wp.from_torch(target), self._data.sensordata)

    def derive(self) -> None:
        """Compute what follows from the written fields."""
        with self.on_stream():
            if self._masses:
                self._mjw.set_const(self._model, self._data, restore=False)
            elif self._derived:
                self._mjw.set_const_fixed(self._model, self._data)
        self._move_fixed_geoms()

    def _move_fixed_geoms(self) -> None:
        """Tell the collision detection where written geoms of the world's body are, which Warp looks up only once."""
        if not len(self._fixed):
            return
        view = self._wp.to_torch
        position, orientation = self.field("geom_pos"), self.field("geom_quat")
        view(self._data.geom_xpos)[:, self._fixed] = position[:, self._fixed]
        view(self._data.geom_xmat)[:, self._fixed] = quat_to_matrix(orientation[:, self._fixed])

    def place(self, rows: Tensor, position: Tensor) -> None:
        """Put worlds at rest.

        Args:
            rows: ``(R,)`` their indices.
            position: ``(R, nq)`` generalised positions.
        """
        time, qpos, qvel, warmstart = self.state
        qpos[rows] = position.to(qpos)
        for value in (time, qvel, warmstart, self.overflow, self.control):
            value[rows] = 0

    def is_sound(self) -> Tensor:
        """``(B,)`` True where the state is within the bounds of MuJoCo and nothing exceeded its room.

        The solver's starting point is the last acceleration, which MuJoCo bounds as well. No bound holds for NaN.
        """
        largest = torch.cat(self.state[1:], -1).abs().amax(-1)
        return (largest <= mujoco.mjMAXVAL) & ((self.overflow & self._lost) == 0)

    # -- fields and copies --------------------------------------------------------------------------------------------

    def field(self, name: str) -> Tensor:
        """A written field, ``(B, n)`` or ``(B, n, c)``; writing to the tensor writes to the model."""
        return self._wp.to_torch(getattr(self._model, name))

    def snapshot(self) -> dict[str, list[Tensor]]:
        """Copies of the written fields and the states, on the CPU."""
        fields = [self.field(name).cpu().clone() for name in self.written]
        return {"fields": fields, "state": [value.cpu().clone() for value in self.state]}

    def restore(self, snapshot: dict[str, list[Tensor]]) -> None:
        """Take over the fields and states of other worlds.

        Args:
            snapshot: what :meth:`snapshot` returned.
        """
        for name, value in zip(self.written, snapshot["fields"], strict=True):
            self.field(name).copy_(value)
        self.derive()
        for own, value in zip(self.state, snapshot["state"], strict=True):
            own.copy_(value)
