"""The interface between an environment and its physics engine."""

from __future__ import annotations

import math
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

__all__ = ["PhysicsEngine", "PhysicsStep", "substeps_per_control_step"]

#: Most physics steps in a control step, of all of which the readings are kept.
_MOST_SUBSTEPS = 2000
Array = NDArray[np.float64]


class PhysicsStep(NamedTuple):
    """The result of one control step of R environments.

    Attributes:
        sensors: ``(R, substeps, S)`` readings, each taken at the beginning of its substep; valid until the next step.
        diverged: ``(R,)`` True where the state blew up; such an environment keeps the state it had before the step.
    """

    sensors: Array
    diverged: NDArray[np.bool_]


class PhysicsEngine(Protocol):
    """Steps ``num_envs`` models that share their structure but not their parameters."""

    num_envs: int
    models: list[Any]

    def reset(self, rows: NDArray[np.int64], joint_position: Array) -> Array:
        """Put environments at rest at given positions, after their models were changed.

        Args:
            rows: ``(R,)`` environment indices.
            joint_position: ``(R, nq)`` generalised positions (``qpos``).

        Returns:
            ``(R, S)`` sensor readings in the new state.
        """
        ...

    def step(self, control: Array, rows: NDArray[np.int64] | None = None) -> PhysicsStep:
        """Advance by one control step, with the control held constant.

        Args:
            control: ``(R, nu)`` inputs of the actuators.
            rows: ``(R,)`` environment indices; None steps all.

        Returns:
            The sensor readings of all substeps, and which environments diverged.
        """
        ...

    def state(self, row: int) -> Array:
        """The full physics state of environment ``row`` (``mjSTATE_FULLPHYSICS``)."""
        ...


def substeps_per_control_step(control_dt: float, physics_dt: float) -> int:
    """Number of physics steps in a control step.

    Args:
        control_dt: time between actions [s].
        physics_dt: time step of the physics [s].

    Returns:
        ``control_dt / physics_dt``, a whole number of at least 1.

    Raises:
        ValueError: if a time step is not positive, or ``control_dt`` is no multiple of ``physics_dt`` or too large a
            one.
    """
    if not (0 < physics_dt < math.inf and 0 < control_dt < math.inf):
        raise ValueError(f"physics_dt={physics_dt} s and control_dt={control_dt} s; expected both above 0 and finite.")
    ratio = control_dt / physics_dt
    if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-6:
        raise ValueError(
            f"control_dt={control_dt} s is {ratio:.6g} times physics_dt={physics_dt} s; expected a whole number. "
            f"Set, for instance, physics_dt={control_dt / max(1, round(ratio)):.12g}."
        )
    if ratio > _MOST_SUBSTEPS:
        raise ValueError(
            f"control_dt={control_dt} s is {ratio:.6g} times physics_dt={physics_dt} s; expected at most "
            f"{_MOST_SUBSTEPS} times. Raise physics_dt, or act more often."
        )
    return round(ratio)
