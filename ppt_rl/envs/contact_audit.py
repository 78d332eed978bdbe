"""Contact force at the rate of the physics, on whatever measures it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from ppt_rl.envs.physics import PhysicsEngine, PhysicsStep
from ppt_rl.envs.readings import sensor_span

__all__ = ["CONTACT", "CONTACT_FORCE", "PRESSING_TIME", "STATIC_TIME", "ContactAudit"]

Array = NDArray[np.float64]
#: Force from which on there is contact [N].
CONTACT_FORCE = 0.5
#: Time after first contact in which the pressing force is looked for, and last part of an episode over which the static
#: force is the mean [s]. ISO/TS 15066 tells transient from quasi-static contact at the first one.
PRESSING_TIME, STATIC_TIME = 0.5, 0.2
#: Names of what is measured of each sensor, in order.
CONTACT = ("peak_force", "static_force", "pressure_force", "contact_time", "contact_speed")


class ContactAudit:
    r"""Wraps an engine and follows force sensors over every physics substep, each in every environment.

    With the force ``f_k`` of substep k, from which the reading at the reset is subtracted (the sensor's own weight):

    .. math::
        \text{peak} = \max_k |f_k|, \qquad
        \text{pressure} = \max_{t_c \le t_k \le t_c + 0.5\,s} |f_k|, \qquad
        \text{static} = \operatorname{mean}_{t_k \ge T - 0.2\,s} |f_k|

    where ``t_c`` is the time of first contact and T the length of the episode.

    Args:
        engine: the engine to wrap.
        model: compiled model, for its sensors.
        sensors: names of its force sensors.
        horizon: length of an episode [s].

    Attributes:
        measured: ``(num_envs, sensors, 5)`` the values of :data:`CONTACT` since the last reset: forces [N], time of
            first contact [s] (NaN before it) and speed of the tool then [m/s].
    """

    def __init__(self, engine: PhysicsEngine, model: Any, sensors: list[str], horizon: float) -> None:
        self._engine = engine
        self._dt = float(model.opt.timestep)
        self._spans = np.asarray([np.r_[sensor_span(model, name, name)] for name in sensors])  # (P, 3)
        self._velocity = sensor_span(model, "linear_velocity", "linear_velocity")
        self._late = round((horizon - STATIC_TIME) / self._dt)  # first substep of the last part
        self._substep = np.zeros(engine.num_envs, dtype=np.int64)
        self._tare = np.zeros((engine.num_envs, *self._spans.shape))
        self._sum = np.zeros((engine.num_envs, len(sensors), 2))  # of the late forces, and their number
        self.measured = np.zeros((engine.num_envs, len(sensors), len(CONTACT)))

    def __getattr__(self, name: str) -> Any:
        """Everything else comes from the wrapped engine."""
        if name == "_engine":
            raise AttributeError(name)
        return getattr(self._engine, name)

    def reset(self, rows: Tensor, position: Tensor) -> Tensor:
        """See :meth:`PhysicsEngine.reset`; the measurements of ``rows`` start again."""
        sensors, index = self._engine.reset(rows, position), rows.numpy()
        self._substep[index], self._sum[index] = 0, 0.0
        self._tare[index] = sensors.numpy()[:, self._spans]
        self.measured[index] = (0.0, 0.0, 0.0, np.nan, 0.0)
        return sensors

    def step(self, control: Tensor, mask: Tensor | None = None) -> PhysicsStep:
        """See :meth:`PhysicsEngine.step`; an environment that diverged is not measured."""
        result = self._engine.step(control, mask)
        measured = ~result.diverged if mask is None else mask & ~result.diverged
        index = measured.nonzero().squeeze(-1).numpy()
        readings = result.sensors.numpy()[index]  # (R, K, S)
        force = np.linalg.norm(readings[:, :, self._spans] - self._tare[index, None], axis=-1)  # (R, K, P)
        substep = self._substep[index, None] + np.arange(force.shape[1])  # (R, K)
        self._substep[index] += force.shape[1]
        speed = np.linalg.norm(readings[:, :, self._velocity], axis=-1)
        self._follow(index, force, substep, speed)
        return result

    def _follow(self, index: NDArray[np.int64], force: Array, substep: NDArray[np.int64], speed: Array) -> None:
        """Take the forces ``(R, K, P)`` of one control step into account."""
        peak, _, pressure, begun, met = np.moveaxis(self.measured[index], -1, 0)
        touching = force > CONTACT_FORCE
        first = touching.argmax(1)  # (R, P)
        fresh = np.isnan(begun) & touching.any(1)
        begun = np.where(fresh, np.take_along_axis(substep, first, 1) * self._dt, begun)
        met = np.where(fresh, np.take_along_axis(speed, first, 1), met)
        since = substep[:, :, None] * self._dt - begun[:, None]  # NaN before contact, which compares as False
        early = np.where((since >= 0) & (since <= PRESSING_TIME), force, 0.0)
        late = (substep >= self._late)[:, :, None]
        self._sum[index] += np.stack([(force * late).sum(1), np.broadcast_to(late.sum(1), force[:, 0].shape)], -1)
        total, count = np.moveaxis(self._sum[index], -1, 0)
        static = total / np.maximum(count, 1)
        peak, pressure = np.maximum(peak, force.max(1)), np.maximum(pressure, early.max(1))
        self.measured[index] = np.stack([peak, static, pressure, begun, met], -1)
