"""What an environment asks of a physics engine."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

__all__ = ["PhysicsEngine", "PhysicsStep", "substeps_per_control_step"]

Array = NDArray[np.float64]


class PhysicsStep(NamedTuple):
    """Result of one control step of R environments.

    Attributes:
        sensors: ``(R, substeps, S)`` readings; substep ``k`` is read at its beginning. Valid until the next step.
        diverged: ``(R,)`` True where the state blew up; such a row keeps the state it had before the step.
    """

    sensors: Array
    diverged: NDArray[np.bool_]


class PhysicsEngine(Protocol):
    """Steps ``num_envs`` models of one topology, each with parameters of its own."""

    num_envs: int
    models: list[Any]

    def reset(self, rows: NDArray[np.int64], joint_position: Array) -> Array:
        """Put rows at rest in a configuration, after their models were changed.

        Args:
            rows: ``(R,)`` environment indices.
            joint_position: ``(R, nq)`` generalised positions (``qpos``).

        Returns:
            ``(R, S)`` sensor readings there.
        """
        ...

    def step(self, control: Array, rows: NDArray[np.int64] | None = None) -> PhysicsStep:
        """Advance by one control step with the control held.

        Args:
            control: ``(R, nu)`` actuator input.
            rows: ``(R,)`` environment indices; None means all.

        Returns:
            Sensor readings of all substeps and the divergence flags.
        """
        ...

    def state(self, row: int) -> Array:
        """Full physics state of one environment (``mjSTATE_FULLPHYSICS``)."""
        ...


def substeps_per_control_step(control_dt: float, physics_dt: float) -> int:
    """Number of physics steps in a control step.

    Args:
        control_dt: [s].
        physics_dt: [s].

    Returns:
        ``control_dt / physics_dt``, a whole number of at least 1.

    Raises:
        ValueError: if either is not positive or the first is no multiple of the second.
    """
    if physics_dt <= 0 or control_dt <= 0:
        raise ValueError(f"physics_dt={physics_dt} s and control_dt={control_dt} s; expected both above 0.")
    ratio = control_dt / physics_dt
    if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-6:
        raise ValueError(
            f"control_dt={control_dt} s is {ratio:.6g} times physics_dt={physics_dt} s; expected a whole number. "
            f"Take for instance physics_dt={control_dt / max(1, round(ratio)):.12g}."
        )
    return round(ratio)
