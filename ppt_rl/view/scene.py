"""The scene of the live view: a node for every body, and the visible shapes below it."""

from __future__ import annotations

from typing import Any

from ppt_rl.envs.drawn import Drawn, body_poses, drawn_shapes

__all__ = ["SceneNodes"]


class SceneNodes:
    """Shows a scene in a browser and moves its bodies.

    Args:
        server: a ``viser.ViserServer``.
    """

    def __init__(self, server: Any) -> None:
        self._server = server
        self._bodies: dict[int, Any] = {}
        self._shapes: dict[str, tuple[Drawn, Any]] = {}
        scene = server.scene
        scene.set_up_direction("+z")
        scene.add_grid(
            "/ground", infinite_grid=True, position=(0.0, 0.0, -0.6), cell_size=0.25, section_size=1.0,
            cell_color=(215, 218, 222), section_color=(185, 190, 196),
        )  # fmt: skip
        scene.configure_default_lights(enabled=False)
        scene.configure_environment_map(None)
        scene.add_light_hemisphere("/light/sky", sky_color=(235, 240, 250), ground_color=(150, 145, 140), intensity=1.4)
        scene.add_light_directional(
            "/light/key", intensity=1.7, cast_shadow=True, position=(0.6, -0.9, 2.0)
        )  # fmt: skip
        server.initial_camera.position = (1.22, -0.95, 0.66)
        server.initial_camera.look_at = (0.44, 0.10, 0.16)
        server.initial_camera.up = (0.0, 0.0, 1.0)

    def show(self, physics: Any) -> None:
        """Draw what has come or changed its shape, remove what has gone, and move the bodies.

        Args:
            physics: a ``dm_control`` Physics with looks.
        """
        shapes = {shape.name: shape for shape in drawn_shapes(physics)}
        with self._server.atomic():
            self.move(physics)
            for name in [name for name in self._shapes if name not in shapes]:
                self._shapes.pop(name)[1].remove()
            for name, shape in shapes.items():
                old, handle = self._shapes.get(name, (None, None))
                if not shape.is_like(old):
                    if handle is not None:
                        handle.remove()
                    self._shapes[name] = shape, self._add(shape)

    def move(self, physics: Any) -> None:
        """Move the bodies.

        Args:
            physics: a ``dm_control`` Physics with looks.
        """
        positions, orientations = body_poses(physics)
        with self._server.atomic():
            for index, (position, orientation) in enumerate(zip(positions, orientations, strict=True)):
                node = self._bodies.get(index)
                if node is None:
                    node = self._bodies[index] = self._server.scene.add_frame(f"/body{index}", show_axes=False)
                node.position, node.wxyz = position, orientation

    def _add(self, shape: Drawn) -> Any:
        red, green, blue, opacity = shape.colour
        return self._server.scene.add_mesh_simple(
            f"/body{shape.body}/{shape.name}",
            shape.vertices,
            shape.triangles,
            color=(round(255 * red), round(255 * green), round(255 * blue)),
            opacity=None if opacity >= 1 else opacity,
            flat_shading=shape.flat,
        )
