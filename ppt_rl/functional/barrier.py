"""Control barriers for the force of the tool: limits on its motion as linear constraints on the force."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from ppt_rl.functional.argument_checks import require_numbers
from ppt_rl.functional.checks import require_last_dim, require_positive

__all__ = ["Barrier", "PlaneBarrier", "SpeedBarrier"]


class Barrier(Protocol):
    """A limit on position or velocity of the tool as a constraint ``normal . force <= offset``.

    Any object with this method, and with a ``rate``, is a barrier of a ``BarrierTransform``.

    Attributes:
        rate: how fast the limit may be approached [1/s].
    """

    rate: float

    def half_space(self, position: Tensor, velocity: Tensor, inertia: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        """The constraint in a state.

        Args:
            position: ``(*B, 3)`` of the end effector [m].
            velocity: ``(*B, 3)`` [m/s].
            inertia: ``(3,)`` apparent inertia along the world's axes [kg].
            dt: control step [s].

        Returns:
            Normal ``(*B, 3)`` [1/kg] and offset ``(*B, 1)`` [m/s^2].
        """
        ...


@dataclass(frozen=True)
class SpeedBarrier:
    r"""Keeps the tool's speed below a limit.

    .. math:: n^\top M^{-1} f \le \alpha\,(v_{max} - \lVert v \rVert), \qquad n = v / \lVert v \rVert

    A force that is held for a control step changes the velocity by ``dt M^-1 f``. So for ``alpha dt <= 1`` the velocity
    along the direction of motion ends at no more than ``w = s + alpha dt (v_max - s)`` from a speed ``s``: below
    ``v_max``, or nearer to it by that share of an excess. Across this direction the force is free, so with the
    acceleration ``a`` the speed ends at no more than ``sqrt(w^2 + (dt a)^2)``. A tool at rest has no direction of
    motion and is not constrained.

    Attributes:
        v_max: largest speed [m/s].
        rate: alpha [1/s].

    Raises:
        ValueError: if a number is not positive.
    """

    v_max: float
    rate: float = 50.0

    def __post_init__(self) -> None:
        """Check the numbers."""
        require_positive("v_max", self.v_max, "m/s")
        require_positive("rate", self.rate, "1/s")

    def half_space(self, position: Tensor, velocity: Tensor, inertia: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        """See :meth:`Barrier.half_space`."""
        require_last_dim("velocity", velocity, 3)
        speed = torch.linalg.vector_norm(velocity, dim=-1, keepdim=True)
        direction = velocity / speed.clamp_min(torch.finfo(speed.dtype).tiny)
        return direction / inertia, self.rate * (self.v_max - speed)


@dataclass(frozen=True)
class PlaneBarrier:
    r"""Keeps the tool on one side of a plane: ``h = n . x - offset >= 0``.

    The force acts on the second derivative of ``h``, so the barrier is one of second order. It asks that
    :math:`\psi = \dot h + \alpha h`, which is at least zero at the start, falls to no less than ``1 - alpha dt`` times
    its value in a control step. For a force that is held over the step this is exactly

    .. math:: -n^\top M^{-1} f \le \alpha\,\frac{2\,\dot h + \alpha\,h}{1 + \alpha\,\Delta t / 2}

    Hence, for ``alpha dt <= 1``, a tool with this inertia on which nothing else acts has ``psi >= 0`` and ``h >= 0`` at
    all control steps once both hold. The control step enters through the denominator; with ``dt`` going to zero it is
    the exponential barrier with both poles at ``-alpha``.

    Attributes:
        normal: from the plane to the allowed side; it is scaled to length 1.
        offset: of the plane along the normal [m].
        rate: alpha [1/s].

    Raises:
        ValueError: if the normal is zero or a number is out of range.

    Source:
        Nguyen and Sreenath 2016, "Exponential control barrier functions for enforcing high relative-degree
        safety-critical constraints", in discrete time.
    """

    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)
    offset: float = 0.0
    rate: float = 10.0

    def __post_init__(self) -> None:
        """Check the numbers."""
        if not require_numbers("normal", self.normal, (3,)).any():
            raise ValueError(f"normal is {self.normal}; expected three numbers that are not all zero.")
        require_numbers("offset", self.offset, (1,), unit="m")
        require_positive("rate", self.rate, "1/s")

    def half_space(self, position: Tensor, velocity: Tensor, inertia: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        """See :meth:`Barrier.half_space`."""
        require_last_dim("position", position, 3)
        require_last_dim("velocity", velocity, 3)
        normal = torch.tensor(self.normal, dtype=torch.float64)
        normal = (normal / normal.norm()).to(position)
        height = (normal * position).sum(-1, keepdim=True) - self.offset
        climb = (normal * velocity).sum(-1, keepdim=True)
        offset = self.rate * (2 * climb + self.rate * height) / (1 + 0.5 * self.rate * dt)
        return (-normal / inertia).expand_as(position), offset
