"""Imports MuJoCo and dm_control in one place, without warnings.

On import, dm_control looks for a display and warns if there is none. This library renders off screen, so this module
chooses a rendering backend first (it respects an existing ``MUJOCO_GL``) and suppresses that warning.
"""

from __future__ import annotations

import ctypes.util
import logging
import os
import warnings

__all__ = ["mjcf", "mujoco", "rendering_backend"]


def rendering_backend() -> str:
    """The rendering backend: ``MUJOCO_GL`` if it is set, else what can be loaded: ``egl``, ``osmesa``, ``disable``."""
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
