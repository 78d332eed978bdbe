"""Obstacles of the collision benchmark: spring-mounted plates, where they stand, and how they enter the scene."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from ppt_rl.envs.limits import Bound, require_within
from ppt_rl.functional.argument_checks import require_instance, require_numbers, shown

__all__ = ["HAND", "WALL", "Obstacle", "Place", "Plate", "add_plates", "facing", "set_solid", "write_plate"]

#: What the plates stand across: the path of the tool, the path of the box; or they lie on the table.
Place = Literal["tool", "box", "table"]
#: Mass of the pad in front of the spring [kg]; with it the stiffest spring is stable at 2 kHz.
PAD_MASS = 0.05
#: Damping of the spring [N s/m], so that the pad does not ring: 4 N at 0.4 m/s.
_PAD_DAMPING = 10.0
#: Inertia that makes a mount immovable in effect [kg].
_IMMOVABLE = 1e8
#: MuJoCo's ``solref`` and ``solimp`` of a contact with a pad, almost rigid: the spring behind it is what gives way.
_RIGID, _FIRM = (0.001, 1.0), (0.95, 0.99, 0.0005)
#: Clear distance between the front of a plate and the tool at the start [m].
_CLEAR = 0.03
_BOUNDS: dict[str, Bound] = {"along": (0.0, 1.0, ""), "gap": (0.0, 0.5, "m"), "jump": (0.0, 1.0, "m")}


@dataclass(frozen=True)
class Plate:
    r"""A plate in front of a spring, like a device that measures pressing force.

    Its front is a pad of 50 g on a spring along the normal of the plate. The force that spring and guide pass on, which
    is the force on who or what stands behind, is measured. It follows :math:`f = K x + d\,\dot x` along the normal.

    Attributes:
        half_size: half thickness, half width and half height [m].
        stiffness: K, of the spring [N/m].
        mass: what can move away behind the spring, along the normal and without friction [kg]; None is immovable.

    Raises:
        ValueError: if a number is out of range.
    """

    half_size: tuple[float, float, float]
    stiffness: float
    mass: float | None = None

    def __post_init__(self) -> None:
        """Check the numbers."""
        require_numbers("Plate.half_size", self.half_size, (3,), unit="m")
        for size in self.half_size:
            require_within("a side of Plate.half_size", size, (1e-4, 1.0, "m"))
        require_within("Plate.stiffness", self.stiffness, (1e3, 1.5e5, "N/m"))
        if self.mass is not None:
            require_within("Plate.mass", self.mass, (0.1, 1e3, "kg"))


#: An immovable wall. Its spring is the stiffest that ISO/TS 15066 has for a part of the body (150 N/mm).
WALL = Plate((0.01, 0.25, 0.05), 150e3)
#: A hand: 0.6 kg with the pad, behind a spring of 75 N/mm (ISO/TS 15066, annex A). It is as wide as the wall, since a
#: tool that slips past a plate strikes its side, where it does not give: 6 cm on either side let 1.2 kN appear there.
HAND = Plate((0.015, 0.25, 0.03), 75e3, 0.6 - PAD_MASS)


@dataclass(frozen=True)
class Obstacle:
    """What an environment meets that it is not told about.

    The plates stand one behind the other; the force on the last one is measured. Its normal is the heading of the push.

    Attributes:
        plates: the plates.
        place: ``"tool"`` across the path of the tool, with the box out of its way; ``"box"`` across that of the box;
            ``"table"`` on the table, under tool and box.
        along: how far on the way from behind the box to the goal the first one stands, or from the box to its goal [-].
        gap: clear distance from one plate to the next [m].
        clamped: whether the masses of the plates are clamped; of several values, episodes take one in turn.
        hold: range of the time after first contact at which the first plate vanishes [s]; None where it stays.
        jump: distance by which the reference jumps towards the plate at a random moment [m].
        at: where the middle of the front of the first plate stands, on the map [m]; None has it stand in the way.

    Raises:
        ValueError: if a number is out of range, or there are too few plates.
    """

    plates: tuple[Plate, ...]
    place: Place = "tool"
    along: float = 0.5
    gap: float = 0.05
    clamped: tuple[bool, ...] = (True,)
    hold: tuple[float, float] | None = None
    jump: float = 0.0
    at: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name, bound in _BOUNDS.items():
            require_within(f"Obstacle.{name}", getattr(self, name), bound)
        if self.place not in get_args(Place):
            raise ValueError(f"Obstacle.place is {shown(self.place)}; expected one of {list(get_args(Place))}.")
        least = 1 if self.hold is None else 2
        if not isinstance(self.plates, tuple) or len(self.plates) < least:
            raise ValueError(f"Obstacle.plates is {shown(self.plates)}; expected a tuple of at least {least} plates.")
        for plate in self.plates:
            require_instance("an entry of Obstacle.plates", plate, Plate)
        if not isinstance(self.clamped, tuple) or not self.clamped:
            raise ValueError(f"Obstacle.clamped is {shown(self.clamped)}; expected a tuple of one truth value or more.")
        if self.at is not None:
            require_numbers("Obstacle.at", self.at, (2,), unit="m")
            if len(self.plates) != 1:
                raise ValueError(f"Obstacle.at places one plate, and there are {len(self.plates)}; expected one.")
        if self.hold is not None:
            low, high = (float(end) for end in require_numbers("Obstacle.hold", self.hold, (2,), unit="s"))
            if not 0 <= low <= high:
                raise ValueError(f"Obstacle.hold is {self.hold}; expected 0 <= low <= high [s].")

    @property
    def rise(self) -> float:
        """How much higher the table is than believed [m]."""
        return 2 * self.plates[0].half_size[0] if self.place == "table" else 0.0


def add_plates(root: Any, obstacle: Obstacle) -> None:
    """Add the plates of an obstacle to a scene; :func:`write_plate` places them.

    Every plate has the bodies ``plate{i}`` and ``plate{i}_pad``, whose x axis is the normal, from the front backwards,
    the geom ``plate{i}`` and the sensor ``plate{i}_force`` of the force that the pad passes on.

    Args:
        root: the scene, changed in place.
        obstacle: the obstacle.
    """
    for index, plate in enumerate(obstacle.plates):
        name = f"plate{index}"
        mount = root.worldbody.add("body", name=name, pos=[0, 0, -1 - index], gravcomp=1)
        if plate.mass is not None:
            mount.add("inertial", pos=[0, 0, 0], mass=plate.mass, diaginertia=[1e-3] * 3)
            mount.add("joint", name=f"{name}_mount", type="slide", axis=[1, 0, 0], armature=_IMMOVABLE)
        pad = mount.add("body", name=f"{name}_pad", gravcomp=1)
        pad.add("inertial", pos=[0, 0, 0], mass=PAD_MASS, diaginertia=[1e-4] * 3)
        pad.add(
            "joint", name=f"{name}_spring", type="slide", axis=[1, 0, 0], stiffness=plate.stiffness,
            damping=_PAD_DAMPING,
        )  # fmt: skip
        pad.add(
            "geom", name=name, type="box", size=plate.half_size, pos=[plate.half_size[0], 0, 0], contype=0,
            conaffinity=1, priority=2, condim=3, friction=[0.3, 0.005, 0.0001], solref=_RIGID, solimp=_FIRM,
            rgba=[0.90, 0.72, 0.58, 1.0] if plate.mass is not None else [0.35, 0.50, 0.62, 1.0], group=2,
        )  # fmt: skip
        site = pad.add("site", name=name, size=[0.002], group=4)
        root.sensor.add("force", name=f"{name}_force", site=site)


def write_plate(
    model: Any, index: int, position: Any, heading: float, *, clamped: bool, meets_box: bool, lies: bool
) -> None:
    """Place one plate in a compiled model, and make it solid.

    Args:
        model: ``mujoco.MjModel`` of a scene with plates, changed in place.
        index: of the plate.
        position: ``(3,)`` of the middle of its front [m].
        heading: of its normal, from the front backwards, on the map [rad].
        clamped: whether the mass behind the spring, if there is one, is clamped.
        meets_box: whether the box can touch it.
        lies: whether its normal points down instead.
    """
    body = model.body(f"plate{index}")
    half = math.pi / 4 if lies else 0.5 * heading
    body.pos[:] = position
    body.quat[:] = (math.cos(half), 0.0, math.sin(half), 0.0) if lies else (math.cos(half), 0.0, 0.0, math.sin(half))
    model.geom(f"plate{index}").contype[0] = 4 if meets_box else 0
    set_solid(model, index, True)
    for dof in range(int(body.dofnum[0])):
        model.dof_armature[int(body.dofadr[0]) + dof] = _IMMOVABLE if clamped else 0.0


def set_solid(model: Any, index: int, solid: bool) -> None:
    """Let a plate exist or vanish.

    Args:
        model: ``mujoco.MjModel``, changed in place.
        index: of the plate.
        solid: whether tool and box can touch it and pictures show it.
    """
    geom = model.geom(f"plate{index}")
    geom.conaffinity[0] = int(solid)
    geom.contype[0] = geom.contype[0] if solid else 0
    geom.rgba[3] = float(solid)


def facing(
    point: np.ndarray, way: np.ndarray, *, start: np.ndarray, end: np.ndarray, tool: tuple[float, float]
) -> float:
    """Heading of the normal of a plate through a point: that of the way, or turned until the tool starts in front.

    A wide plate across an oblique push may reach the place where the tool starts. Its normal then turns towards the
    line from there to the end of the push, as little as need be.

    Args:
        point: ``(2,)`` of the middle of the front [m].
        way: ``(2,)`` direction in which the push goes there.
        start: ``(2,)`` where the tool starts [m].
        end: ``(2,)`` where it ends [m].
        tool: half size of the tool along x and y at the start [m].

    Returns:
        The heading [rad].
    """
    push, overall = math.atan2(way[1], way[0]), math.atan2(end[1] - start[1], end[0] - start[0])
    heading = push + np.linspace(0.0, 1.0, 21) * (overall - push)
    ahead = np.stack([np.cos(heading), np.sin(heading)], -1)
    clear = ahead @ (point - start) - np.abs(ahead) @ np.asarray(tool)
    enough = clear >= _CLEAR
    return float(heading[enough.argmax() if enough.any() else -1])
