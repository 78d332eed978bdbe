"""The interface between an environment and its physics engine."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ppt_rl.envs.physics.parameters import Parameter

__all__ = ["PhysicsEngine", "PhysicsStep", "substeps_per_control_step"]

#: Most physics steps in a control step, of all of which the readings are kept.
_MOST_SUBSTEPS = 2000


class PhysicsStep(NamedTuple):
    """The result of one control step of B environments. Rows of environments that did not step mean nothing.

    Attributes:
        sensors: ``(B, K, S)`` readings of the last K substeps, each taken at the beginning of its substep; valid until
            the next step. K is the number of substeps, or 1 for an engine that keeps only the last readings.
        diverged: ``(B,)`` True where the state blew up; such an environment keeps the state it had before the step.
    """

    sensors: Tensor
    diverged: Tensor


class PhysicsEngine(Protocol):
    """Steps ``num_envs`` worlds that share their structure but not their parameters.

    Every tensor lives on ``device``. Positions, controls and readings are real numbers of any precision; an engine
    computes in its own.
    """

    num_envs: int
    device: torch.device

    def write(self, rows: Tensor, parameters: Sequence[Parameter]) -> None:
        """Write parameters into the models of some environments; call :meth:`reset` for these rows afterwards.

        Args:
            rows: ``(R,)`` indices of the environments.
            parameters: what to write; their values are those of all environments.
        """
        ...

    def reset(self, rows: Tensor, position: Tensor) -> Tensor:
        """Put environments at rest at given positions. What the models derive from their parameters is computed anew.

        Args:
            rows: ``(R,)`` indices of the environments.
            position: ``(R, nq)`` generalised positions (``qpos``).

        Returns:
            ``(R, S)`` sensor readings in the new state.
        """
        ...

    def step(self, control: Tensor, mask: Tensor | None = None) -> PhysicsStep:
        """Advance by one control step, with the control held constant.

        Args:
            control: ``(num_envs, nu)`` inputs of the actuators.
            mask: ``(num_envs,)`` True for the environments that step; None steps all.

        Returns:
            The sensor readings, and which environments diverged.
        """
        ...

    def state(self, row: int) -> NDArray[np.float64]:
        """The full physics state of environment ``row`` (``mjSTATE_FULLPHYSICS``)."""
        ...

    def close(self) -> None:
        """Free what the engine holds."""
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
