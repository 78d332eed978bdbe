"""What a tool that slides and sticks can remember of its motion: where it was going, and which way it creeps."""

from __future__ import annotations

import torch
from torch import Tensor

from ppt_rl.functional.checks import require_last_dim

__all__ = ["follow_course", "follow_creep"]


def follow_creep(creep: Tensor, velocity: Tensor, *, dt: float, slow: float = 0.03, memory: float = 0.4) -> Tensor:
    r"""How far a tool that is held up has crept lately.

    .. math::
        c' = \begin{cases} c + \Delta t\,(v - c / T) & |v| < v_s \\ c & v_s \le |v| \le 2 v_s \\ 0 & |v| > 2 v_s
            \end{cases}

    Friction lets a tool that is pushed against a wall stick, and then the direction of the force says only where it is
    pushed. But it still creeps by some millimetres per second, to the side to which the wall gives way.

    Args:
        creep: ``(*B, 2)`` c [m].
        velocity: ``(*B, 2)`` horizontal velocity v of the tool, the same axes [m/s].
        dt: control step [s].
        slow: v_s, a slower tool is held up, one that is twice as fast is free [m/s].
        memory: T, time in which creep is forgotten [s].

    Returns:
        ``(*B, 2)`` after one more control step [m].

    Raises:
        ValueError: if a shape does not fit.

    Source:
        Ours.
    """
    require_last_dim("creep", creep, 2)
    require_last_dim("velocity", velocity, 2)
    speed = torch.linalg.vector_norm(velocity, dim=-1, keepdim=True)
    crept = creep + dt * (velocity - creep / memory)
    return torch.where(speed < slow, crept, torch.where(speed > 2 * slow, torch.zeros_like(creep), creep))


def follow_course(course: Tensor, velocity: Tensor, *, dt: float, distance: float = 0.08) -> Tensor:
    r"""Direction in which a tool has travelled lately.

    .. math:: u' = u + \frac{\Delta t}{\ell}\,(v - |v|\,u)

    It forgets over the distance ``l`` travelled, not over time, so it stays where a tool is stuck and turns its
    reference this way and that. It is as long as 1 on a straight path, and shorter on a curved one.

    Args:
        course: ``(*B, 2)`` u [-].
        velocity: ``(*B, 2)`` horizontal velocity v of the tool, the same axes [m/s].
        dt: control step [s].
        distance: l [m].

    Returns:
        ``(*B, 2)`` after one more control step [-].

    Raises:
        ValueError: if a shape does not fit.

    Source:
        Ours.
    """
    require_last_dim("course", course, 2)
    require_last_dim("velocity", velocity, 2)
    speed = torch.linalg.vector_norm(velocity, dim=-1, keepdim=True)
    return course + (dt / distance) * (velocity - speed * course)
