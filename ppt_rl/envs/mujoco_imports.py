"""MuJoCo and dm_control, imported once and quietly.

dm_control probes for a display when it is imported and warns when there is none. The library renders off screen, so
the rendering backend is chosen first (an existing ``MUJOCO_GL`` is respected) and that warning is kept from the user.
"""

from __future__ import annotations

import ctypes.util
import logging
import os
import warnings

__all__ = ["mjcf", "mujoco", "rendering_backend"]


def rendering_backend() -> str:
    """Rendering backend that this machine can load: ``"egl"``, ``"osmesa"`` or ``"disable"``."""
    chosen = os.environ.get("MUJOCO_GL")
    if chosen:
        return chosen
    if ctypes.util.find_library("EGL"):
        return "egl"
    return "osmesa" if ctypes.util.find_library("OSMesa") else "disable"


os.environ.setdefault("MUJOCO_GL", rendering_backend())

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    _level = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        import mujoco
        from dm_control import mjcf
    finally:
        logging.disable(_level)
