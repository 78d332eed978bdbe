"""What the force at the wrist reveals about the wall that a tool touches."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real
from typing import NamedTuple

import torch
from torch import Tensor

from ppt_rl.functional.checks import require_last_dim, require_positive
from ppt_rl.functional.shape_checks import require_bool

__all__ = ["WallContact", "WallTouch", "is_touching", "wall_contact"]


@dataclass(frozen=True)
class WallTouch:
    """How a tool tells a wall from the force at the wrist.

    Attributes:
        friction: mu, an estimate of the friction of walls and floor on the tool [-].
        slow: v_s, the speed below which the force is trusted more than the motion [m/s].
        on: contact begins above this force on the wall [N].
        off: contact ends below this force on the wall [N], at most ``on``.
    """

    friction: float = 0.25
    slow: float = 0.01
    on: float = 1.0
    off: float = 0.5

    def __post_init__(self) -> None:
        """Refuse impossible numbers."""
        require_positive("friction", self.friction)
        require_positive("slow", self.slow, "m/s")
        numbers = isinstance(self.on, Real) and isinstance(self.off, Real)
        if not numbers or not math.inf > self.on >= self.off > 0:
            raise ValueError(f"on and off are {self.on} and {self.off} N; expected on >= off > 0, both finite.")


class WallContact(NamedTuple):
    """A wall as the tool feels it, in the horizontal plane, world axes.

    Attributes:
        force: ``(*B, 2)`` force of the robot on the wall, without the floor's friction [N].
        normal: ``(*B, 2)`` unit vector into the wall [-].
        tangent: ``(*B, 2)`` unit vector along the wall, in the direction of the tool's motion [-].
    """

    force: Tensor
    normal: Tensor
    tangent: Tensor


def is_touching(touching: Tensor, force: Tensor, *, on: float, off: float) -> Tensor:
    """Contact with hysteresis: it begins above one force and ends below a smaller one.

    Args:
        touching: ``(*B, 1)`` bool, whether there was contact before.
        force: ``(*B, 1)`` magnitude of the force [N].
        on: contact begins above this force [N].
        off: contact ends below this force [N].

    Returns:
        ``(*B, 1)`` bool, whether there is contact.

    Raises:
        ValueError: if ``touching`` is not boolean.
    """
    require_bool("touching", touching)
    return force > torch.where(touching, off, on)


def wall_contact(force: Tensor, velocity: Tensor, heading: Tensor, *, friction: float, slow: float) -> WallContact:
    r"""Normal and tangent of a wall, from force and motion.

    While the tool slides, its velocity gives the tangent. Where it is held up, the force does, which friction tilts
    from the normal towards the motion by ``atan(mu)``:

    .. math::
        f_w &= f_{xy} - \mu\,|f_z|\,v / (|v| + v_s), \quad s = \operatorname{sign}(h \times f_w) \\
        n_f &= R(s \arctan\mu)\, f_w / |f_w|, \quad t_f = R(-s\,\pi/2)\, n_f \\
        t &\propto w\,v/|v| + (1 - w)\, t_f, \quad n = R(s\,\pi/2)\, t, \qquad w = |v|^2 / (|v|^2 + v_s^2)

    ``h`` is the direction of the heading, and ``s`` is +1 with the wall on the left. A velocity against the heading has
    the weight ``w = 0``.

    Args:
        force: ``(*B, 3)`` force of the robot on the world at the tool, world axes [N].
        velocity: ``(*B, 2)`` horizontal velocity v of the tool, world axes [m/s].
        heading: ``(*B, 1)`` heading of the tool [rad].
        friction: mu, an estimate of the friction of walls and floor on the tool [-].
        slow: v_s, the speed below which the force is trusted more than the motion [m/s].

    Returns:
        The wall. Without any force, its tangent is the direction of motion, or the heading of a tool at rest.

    Raises:
        ValueError: if a shape does not fit.

    Source:
        Ours.
    """
    for name, value, size in (("force", force, 3), ("velocity", velocity, 2), ("heading", heading, 1)):
        require_last_dim(name, value, size)
    ahead = torch.cat([heading.cos(), heading.sin()], -1)
    speed = torch.linalg.vector_norm(velocity, dim=-1, keepdim=True)
    on_floor = friction * force[..., 2:3].abs() * velocity / (speed + slow)
    on_wall = force[..., :2] - on_floor
    cross = ahead[..., :1] * on_wall[..., 1:] - ahead[..., 1:] * on_wall[..., :1]
    side = torch.where(cross >= 0, 1.0, -1.0).to(force.dtype)
    size = torch.linalg.vector_norm(on_wall, dim=-1, keepdim=True)
    pushed = on_wall / size.clamp_min(1e-9)
    turn = side * (math.atan(friction) - math.pi / 2)  # from the force to the tangent
    felt = torch.where(size > 1e-6, _turned(pushed, turn.cos(), turn.sin()), ahead)
    forward = ((velocity * ahead).sum(-1, keepdim=True) > 0).to(force.dtype)
    weight = forward * speed.square() / (speed.square() + slow**2)
    tangent = weight * velocity / speed.clamp_min(1e-9) + (1 - weight) * felt
    tangent = tangent / torch.linalg.vector_norm(tangent, dim=-1, keepdim=True).clamp_min(1e-9)
    return WallContact(on_wall, _turned(tangent, torch.zeros_like(side), side), tangent)


def _turned(vector: Tensor, cos: Tensor, sin: Tensor) -> Tensor:
    """Rotate horizontal vectors to the left by an angle of this cosine and sine."""
    x, y = vector[..., :1], vector[..., 1:]
    return torch.cat([cos * x - sin * y, sin * x + cos * y], -1)
