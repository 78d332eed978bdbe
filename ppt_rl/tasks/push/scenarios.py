"""The scenarios of the collision benchmark on box pushing."""

from __future__ import annotations

from functools import partial
from typing import Any

from torchrl.envs import Transform

from ppt_rl.envs.push import HAND, WALL, Obstacle, Plate
from ppt_rl.evaluation import Scenario, beside_the_reference
from ppt_rl.tasks.push.config import make_push_env
from ppt_rl.tasks.push.faults import JumpingReferenceTransform, WrongWrenchTransform

__all__ = ["MOVABLE", "SCENARIOS"]

#: A block that is moved by hand, in the live view: it begins beside the table's middle, out of the way.
MOVABLE = Obstacle((Plate((0.02, 0.05, 0.05), WALL.stiffness),), place="box", at=(0.40, 0.32))

#: How much too stiff the controller is [-], and by how much the wrench is late [control steps] or scaled [-].
_STIFFER, _DELAY, _SCALE = 10.0, 2, 0.5
#: A table that is 2 cm too high: a slab of that thickness under the tool.
_SLAB = Plate((0.01, 0.35, 0.35), WALL.stiffness)


def _stiffer(config: Any) -> dict[str, Any]:
    return {"stiffness": _STIFFER * config.stiffness}


def _jumping(chain: list[Transform]) -> list[Transform]:
    return beside_the_reference(chain, JumpingReferenceTransform())


def _misread(chain: list[Transform]) -> list[Transform]:
    return [WrongWrenchTransform(_DELAY, _SCALE), *chain]


def _scenario(name: str, summary: str, obstacle: Obstacle, **changes: Any) -> Scenario:
    return Scenario(name, summary, partial(make_push_env, obstacle=obstacle), **changes)


_WALL = Obstacle((WALL,))
SCENARIOS = (
    _scenario("blocked", "the tool meets a wall at full speed", _WALL),
    _scenario("jammed", "the box is jammed against a stop half-way to its goal", Obstacle((WALL,), place="box")),
    _scenario(
        "hand",
        "the tool meets a hand, which is clamped in half of the episodes and free in the others",
        Obstacle((HAND,), clamped=(True, False)),
        kinds=("constrained", "free"),
    ),
    _scenario(
        "jump",
        "the reference jumps by 10 cm towards the wall at a random moment",
        Obstacle((WALL,), jump=0.1),
        chain=_jumping,
    ),
    _scenario("stiff", "the tool meets the wall with ten times the stiffness", _WALL, options=_stiffer),
    _scenario("table", "the table is 2 cm higher than believed", Obstacle((_SLAB,), place="table")),
    _scenario(
        "release",
        "a stop that the tool pushes against vanishes, 5 cm in front of a wall",
        Obstacle((WALL, WALL), along=0.3, hold=(0.05, 0.15)),
    ),
    _scenario(
        "sensor",
        "the tool meets the wall, with the measured wrench delayed by 20 ms or halved",
        Obstacle((WALL,), clamped=(True, True)),
        chain=_misread,
        kinds=("delayed", "halved"),
    ),
)
