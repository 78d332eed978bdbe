"""Robot arms as data: one file for each arm."""

from __future__ import annotations

import importlib
import pkgutil

from ppt_rl.arms.arm import Arm
from ppt_rl.arms.fr3 import FR3
from ppt_rl.arms.panda import PANDA
from ppt_rl.arms.ur5e import UR5E

__all__ = ["FR3", "PANDA", "UR5E", "Arm", "find_arm"]


def find_arm(name: str) -> Arm:
    """An arm by its name.

    Args:
        name: as in :attr:`Arm.name`, for instance ``"panda"``.

    Returns:
        The arm of that name in one of the package's modules.

    Raises:
        ValueError: if there is none.
    """
    modules = [importlib.import_module(f"{__name__}.{module.name}") for module in pkgutil.iter_modules(__path__)]
    arms = {value.name: value for module in modules for value in vars(module).values() if isinstance(value, Arm)}
    if name not in arms:
        raise ValueError(f"no arm is called {name!r}; expected one of {sorted(arms)}.")
    return arms[name]
