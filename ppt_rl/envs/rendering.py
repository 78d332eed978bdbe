"""Pictures of a scene, off screen."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppt_rl.envs.mujoco_imports import mjcf, mujoco, rendering_backend

__all__ = ["SceneRenderer", "require_rendering"]


def require_rendering() -> None:
    """Raise where nothing can be rendered.

    Raises:
        RuntimeError: if no OpenGL library is found.
    """
    if rendering_backend() == "disable":
        raise RuntimeError(
            "rendering needs an OpenGL library and none was found; install EGL or OSMesa "
            "(Debian and Ubuntu: apt-get install libegl1 or libosmesa6)."
        )


class SceneRenderer:
    """A scene with its looks, which the physics models do without.

    Args:
        scene: ``dm_control.mjcf.RootElement``.

    Attributes:
        physics: the ``dm_control`` Physics of the scene.
    """

    def __init__(self, scene: Any) -> None:
        self.physics = mjcf.Physics.from_mjcf_model(scene)

    def at(self, state: NDArray[np.float64]) -> Any:
        """The physics in a state.

        Args:
            state: full physics state (``mjSTATE_FULLPHYSICS``).

        Returns:
            The physics.
        """
        model, data = self.physics.model.ptr, self.physics.data.ptr
        mujoco.mj_setState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        mujoco.mj_forward(model, data)
        return self.physics

    def picture(self, camera: str, width: int, height: int) -> NDArray[np.uint8]:
        """Picture of the present state.

        Args:
            camera: name of a camera of the scene.
            width: [pixels].
            height: [pixels].

        Returns:
            ``(height, width, 3)`` RGB image.

        Raises:
            ValueError: if the scene has no such camera.
        """
        model = self.physics.model
        cameras = [model.id2name(index, "camera") for index in range(model.ncam)]
        if camera not in cameras:
            raise ValueError(f"camera is {camera!r}; expected one of {cameras}.")
        return self.physics.render(height=height, width=width, camera_id=camera)
