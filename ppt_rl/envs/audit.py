"""Power and work at the rate of the physics, the truth that books kept at control rate are held against."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ppt_rl.envs.physics import PhysicsEngine, PhysicsStep
from ppt_rl.envs.physics.base import Array
from ppt_rl.envs.readings import ArmReadings
from ppt_rl.functional.impedance import power

__all__ = ["AUDITED", "AuditedPhysics"]

#: What is audited, in order.
AUDITED = ("commanded_work", "commanded_power", "measured_work", "measured_power")


class AuditedPhysics:
    r"""An engine that integrates power over every substep of another one.

    .. math::
        W_c = \sum_k |\tau \cdot \dot q_k|\,h, \quad P_c = \max_k |\tau \cdot \dot q_k|, \qquad
        W_m = \sum_k |\lambda_k \cdot \nu_k|\,h, \quad P_m = \max_k |\lambda_k \cdot \nu_k|

    since the last reset, with ``h`` the physics step, ``tau`` the torque held over the control step and ``lambda``,
    ``nu`` wrench and twist of the wrist sensor. As in the tank, braking counts like pushing.

    Args:
        engine: what steps the physics.
        model: compiled model, for its sensors.
    """

    def __init__(self, engine: PhysicsEngine, model: Any) -> None:
        self._engine = engine
        self._dt = float(model.opt.timestep)
        self._readings = ArmReadings(model, torch.float64)
        self.totals = np.zeros((engine.num_envs, len(AUDITED)))

    def __getattr__(self, name: str) -> Any:
        """Everything else is the engine's."""
        if name == "_engine":
            raise AttributeError(name)
        return getattr(self._engine, name)

    def reset(self, rows: NDArray[np.int64], joint_position: Array) -> Array:
        """See :meth:`PhysicsEngine.reset`; the books of the rows are opened anew."""
        self.totals[rows] = 0.0
        return self._engine.reset(rows, joint_position)

    def step(self, control: Array, rows: NDArray[np.int64] | None = None) -> PhysicsStep:
        """See :meth:`PhysicsEngine.step`; a row that diverged books nothing."""
        result = self._engine.step(control, rows)
        commanded, measured = (values.abs().numpy() for values in self._powers(result.sensors, control))  # (R, K)
        books = np.stack(
            [commanded.sum(-1) * self._dt, commanded.max(-1), measured.sum(-1) * self._dt, measured.max(-1)], -1
        )
        books[result.diverged] = 0.0
        index = slice(None) if rows is None else rows
        totals = self.totals[index]
        totals[:, ::2] += books[:, ::2]  # works add up
        totals[:, 1::2] = np.maximum(totals[:, 1::2], books[:, 1::2])  # powers leave their largest
        self.totals[index] = totals
        return result

    def _powers(self, sensors: Array, control: Array) -> tuple[Tensor, Tensor]:
        """Commanded and measured power ``(R, K)`` at the beginning of each substep [W]."""
        count, substeps = sensors.shape[:2]
        flat = torch.from_numpy(sensors).reshape(count * substeps, -1)
        read = self._readings.observe(flat)
        torque = torch.from_numpy(np.asarray(control)).repeat_interleave(substeps, 0)
        commanded = power(torque, read["joint_velocity"])
        measured = power(read["wrench"], read["twist"])
        return commanded.reshape(count, substeps), measured.reshape(count, substeps)

    def observe(self, dtype: torch.dtype) -> dict[str, Tensor]:
        """The books since the last reset.

        Args:
            dtype: of the tensors.

        Returns:
            For each name of :data:`AUDITED` a tensor ``(num_envs, 1)``: work [J], largest power [W].
        """
        totals = torch.from_numpy(self.totals).to(dtype, copy=True)
        return dict(zip(AUDITED, totals.split(1, -1), strict=True))
