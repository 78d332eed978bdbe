"""Off-screen pictures of a scene."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppt_rl.envs.mujoco_imports import mjcf, mujoco, rendering_backend

__all__ = ["RenderedScenes", "SceneRenderer", "require_rendering"]


def require_rendering() -> None:
    """Raise an error on a machine that cannot render.

    Raises:
        RuntimeError: if no OpenGL library is found.
    """
    if rendering_backend() == "disable":
        raise RuntimeError(
            "rendering needs an OpenGL library, and none was found. Install EGL or OSMesa "
            "(Debian and Ubuntu: apt-get install libegl1 or libosmesa6)."
        )


class SceneRenderer:
    """A scene with its looks, which the models of the physics leave out.

    Args:
        scene: ``dm_control.mjcf.RootElement``.

    Attributes:
        physics: the ``dm_control`` Physics of the scene.
    """

    def __init__(self, scene: Any) -> None:
        self.physics = mjcf.Physics.from_mjcf_model(scene)

    def show(self, state: NDArray[np.float64]) -> None:
        """Put the scene into a state.

        Args:
            state: full physics state (``mjSTATE_FULLPHYSICS``).
        """
        model, data = self.physics.model.ptr, self.physics.data.ptr
        mujoco.mj_setState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        mujoco.mj_forward(model, data)

    def picture(self, camera: str, width: int, height: int) -> NDArray[np.uint8]:
        """Render the present state.

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
        # The renderer's picture is a view with its rows upside down, which torch does not accept.
        return np.ascontiguousarray(self.physics.render(height=height, width=width, camera_id=camera))


class RenderedScenes:
    """Mixin that renders environments, for a class with a scene, an engine and parameters written for each episode."""

    num_envs: int
    engine: Any
    _scene: Callable[[], Any]
    _write_parameters: Callable[[Any, int], None]
    _require_open: Callable[[], None]
    _rendered: SceneRenderer | None = None

    def physics(self, index: int = 0) -> Any:
        """A ``dm_control`` Physics of the scene with its looks, in the state of one environment.

        Args:
            index: environment index.

        Returns:
            The physics. Changing it does not change the environment. The next call returns the same object.

        Raises:
            IndexError: if there is no such environment.
            RuntimeError: if the environment is closed.
        """
        return self._showing(index).physics

    def render(
        self, index: int = 0, *, camera: str = "overview", width: int = 640, height: int = 480
    ) -> NDArray[np.uint8]:
        """Render one environment off screen.

        This is what torchrl's ``PixelRenderTransform`` calls. Of a batch it shows environment 0, unless it is given
        another ``index``.

        Args:
            index: environment index.
            camera: name of a camera of the scene: ``overview``, ``close``, ``side`` or ``top``.
            width: [pixels].
            height: [pixels].

        Returns:
            ``(height, width, 3)`` RGB image.

        Raises:
            ValueError: if the scene has no such camera.
            IndexError: if there is no such environment.
            RuntimeError: if no OpenGL library is found, or the environment is closed.
        """
        require_rendering()
        return self._showing(index).picture(camera, width, height)

    def _write_looks(self, model: Any, row: int) -> None:
        """Write what only pictures show of environment ``row``, such as marks, into the renderer's model."""

    def _showing(self, index: int) -> SceneRenderer:
        """The scene with the parameters and in the state of environment ``index``."""
        self._require_open()
        if not 0 <= index < self.num_envs:
            raise IndexError(f"environment {index} of {self.num_envs}; expected 0 to {self.num_envs - 1}.")
        if self._rendered is None:
            self._rendered = SceneRenderer(self._scene())
        model = self._rendered.physics.model.ptr
        self._write_parameters(model, index)
        self._write_looks(model, index)
        self._rendered.show(self.engine.state(index))
        return self._rendered

    def _free_renderer(self) -> None:
        if self._rendered is not None:
            self._rendered.physics.free()
            self._rendered = None
