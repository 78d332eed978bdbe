"""Robot arms as data: one file for each arm."""

from __future__ import annotations

import importlib
import pkgutil

from ppt_rl.arms.arm import Arm, Inertial, Joints, Limits, Shell
from ppt_rl.arms.chain import Chain, DHRow, Offset
from ppt_rl.arms.fr3 import FR3
from ppt_rl.arms.panda import PANDA
from ppt_rl.arms.ur5e import UR5E

__all__ = [
    "FR3",
    "PANDA",
    "UR5E",
    "Arm",
    "Chain",
    "DHRow",
    "Inertial",
    "Joints",
    "Limits",
    "Offset",
    "Shell",
    "arm_names",
    "find_arm",
]


def arm_names() -> list[str]:
    """The names of all arms in the files of this package, sorted."""
    return sorted(_arms())


def find_arm(name: str) -> Arm:
    """Find an arm by its name, in any file of this package.

    Args:
        name: as in :attr:`Arm.name`, for instance ``"ur5e"``.

    Returns:
        The arm.

    Raises:
        ValueError: if no arm has that name.
    """
    arms = _arms()
    if not isinstance(name, str) or name not in arms:
        raise ValueError(f"arm {name!r} is unknown; expected one of {sorted(arms)}.")
    return arms[name]


def _arms() -> dict[str, Arm]:
    modules = [importlib.import_module(f"{__name__}.{module.name}") for module in pkgutil.iter_modules(__path__)]
    return {value.name: value for module in modules for value in vars(module).values() if isinstance(value, Arm)}
