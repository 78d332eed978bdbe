"""Power and work at the rate of the physics, with which an accounting at control rate can be compared."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ppt_rl.envs.physics import PhysicsEngine, PhysicsStep
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
        self._readings = ArmReadings(model, torch.float64, engine.device)
        self.totals = torch.zeros(engine.num_envs, len(AUDITED), dtype=torch.float64, device=engine.device)

    def __getattr__(self, name: str) -> Any:
        """Everything else comes from the wrapped engine."""
        if name == "_engine":
            raise AttributeError(name)
        return getattr(self._engine, name)

    def reset(self, rows: Tensor, position: Tensor) -> Tensor:
        """See :meth:`PhysicsEngine.reset`; the totals of ``rows`` start again at zero."""
        self.totals = self.totals.index_fill(0, rows, 0.0)
        return self._engine.reset(rows, position)

    def step(self, control: Tensor, mask: Tensor | None = None) -> PhysicsStep:
        """See :meth:`PhysicsEngine.step`; an environment that diverged adds nothing to its totals."""
        result = self._engine.step(control, mask)
        commanded, measured = (values.abs() for values in self._powers(result.sensors, control))  # (B, K)
        counts = ~result.diverged if mask is None else mask & ~result.diverged
        work = torch.stack([commanded.sum(-1), measured.sum(-1)], -1) * self._dt
        peak = torch.stack([commanded.amax(-1), measured.amax(-1)], -1)
        before = self.totals.unflatten(-1, (2, 2))
        after = torch.stack([before[..., 0] + work, torch.maximum(before[..., 1], peak)], -1)
        self.totals = torch.where(counts.unsqueeze(-1), after.flatten(1), self.totals)
        return result

    def _powers(self, sensors: Tensor, control: Tensor) -> tuple[Tensor, Tensor]:
        """Commanded and measured power ``(B, K)`` at the beginning of each substep [W]."""
        count, substeps = sensors.shape[:2]
        read = self._readings.observe(sensors.reshape(count * substeps, -1).double())
        torque = control.double().repeat_interleave(substeps, 0)
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
        totals = self.totals.to(dtype, copy=True)
        return dict(zip(AUDITED, totals.split(1, -1), strict=True))
