"""Power and work at the rate of the physics, with which an accounting at control rate can be compared."""

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

#: Names of the audited quantities, in order.
AUDITED = ("commanded_work", "commanded_power", "measured_work", "measured_power")


class AuditedPhysics:
    r"""Wraps an engine and integrates power over every physics substep.

    .. math::
        W_c = \sum_k |\tau \cdot \dot q_k|\,h, \quad P_c = \max_k |\tau \cdot \dot q_k|, \qquad
        W_m = \sum_k |\lambda_k \cdot \nu_k|\,h, \quad P_m = \max_k |\lambda_k \cdot \nu_k|

    since the last reset, where ``h`` is the physics time step, ``tau`` the torque held over the control step, and
    ``lambda`` and ``nu`` are the measured wrench and twist. As in the tank, braking counts like pushing.

    Args:
        engine: the engine to wrap.
        model: compiled model, for its sensors.
    """

    def __init__(self, engine: PhysicsEngine, model: Any) -> None:
        self._engine = engine
        self._dt = float(model.opt.timestep)
        self._readings = ArmReadings(model, torch.float64)
        self.totals = np.zeros((engine.num_envs, len(AUDITED)))

    def __getattr__(self, name: str) -> Any:
        """Everything else comes from the wrapped engine."""
        if name == "_engine":
            raise AttributeError(name)
        return getattr(self._engine, name)

    def reset(self, rows: NDArray[np.int64], joint_position: Array) -> Array:
        """See :meth:`PhysicsEngine.reset`; the totals of ``rows`` start again at zero."""
        self.totals[rows] = 0.0
        return self._engine.reset(rows, joint_position)

    def step(self, control: Array, rows: NDArray[np.int64] | None = None) -> PhysicsStep:
        """See :meth:`PhysicsEngine.step`; an environment that diverged adds nothing to its totals."""
        result = self._engine.step(control, rows)
        commanded, measured = (values.abs().numpy() for values in self._powers(result.sensors, control))  # (R, K)
        spent = np.stack(
            [commanded.sum(-1) * self._dt, commanded.max(-1), measured.sum(-1) * self._dt, measured.max(-1)], -1
        )
        spent[result.diverged] = 0.0
        index = slice(None) if rows is None else rows
        totals = self.totals[index]
        totals[:, ::2] += spent[:, ::2]  # work adds up
        totals[:, 1::2] = np.maximum(totals[:, 1::2], spent[:, 1::2])  # power keeps its maximum
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
        """The totals since the last reset.

        Args:
            dtype: of the tensors.

        Returns:
            A tensor ``(num_envs, 1)`` for each name in :data:`AUDITED`: work [J] or largest power [W].
        """
        totals = torch.from_numpy(self.totals).to(dtype, copy=True)
        return dict(zip(AUDITED, totals.split(1, -1), strict=True))
