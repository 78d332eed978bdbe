"""What a scene looks like as triangles, for a viewer of its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppt_rl.arms import Shell
from ppt_rl.envs.models.shapes import Mesh, shell_mesh
from ppt_rl.envs.mujoco_imports import mujoco

__all__ = ["Drawn", "body_poses", "drawn_shapes"]

Array = NDArray[np.float64]
#: Groups of geoms that pictures show: those up to this one.
_LAST_GROUP = 2
_CORNERS = np.asarray([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
_SIDES = np.asarray(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
     [1, 5, 7], [1, 7, 3]], dtype=np.int32,
)  # fmt: skip


@dataclass(frozen=True)
class Drawn:
    """One visible shape.

    Attributes:
        name: unique name.
        body: index of the body that carries it.
        vertices: ``(V, 3)`` in the body's frame [m].
        triangles: ``(F, 3)`` indices of vertices, anticlockwise as seen from outside.
        colour: red, green, blue and opacity, each in [0, 1].
        flat: whether its faces are flat, so that their edges must not be smoothed.
    """

    name: str
    body: int
    vertices: Array
    triangles: NDArray[np.int32]
    colour: tuple[float, float, float, float]
    flat: bool

    def is_like(self, other: Drawn | None) -> bool:
        """Whether it looks the same as another one in the frame of their body.

        Args:
            other: the other one, or None.

        Returns:
            True if shape and colour are equal.
        """
        return other is not None and self.colour == other.colour and np.array_equal(self.vertices, other.vertices)


def drawn_shapes(physics: Any) -> list[Drawn]:
    """The visible shapes of a scene; planes are left out.

    Args:
        physics: a ``dm_control`` Physics with looks, such as ``env.physics(0)``.

    Returns:
        The shapes.
    """
    model = physics.model.ptr
    shapes = []
    for index in range(model.ngeom):
        geom = model.geom(index)
        opacity = float(geom.rgba[3])
        if int(model.geom_group[index]) > _LAST_GROUP or opacity == 0 or model.geom_type[index] == _PLANE:
            continue
        vertices, triangles = _mesh(model, index)
        turn = np.empty(9)
        mujoco.mju_quat2Mat(turn, model.geom_quat[index])
        red, green, blue = (float(value) for value in _colour(model, index))
        shapes.append(
            Drawn(
                f"{index}_{geom.name.replace('/', '_')}",
                int(model.geom_bodyid[index]),
                vertices @ turn.reshape(3, 3).T + model.geom_pos[index],
                triangles,
                (red, green, blue, opacity),
                model.geom_type[index] == _BOX,
            )
        )
    return shapes


def body_poses(physics: Any) -> tuple[Array, Array]:
    """Where the bodies of a scene are.

    Args:
        physics: a ``dm_control`` Physics.

    Returns:
        Positions ``(N, 3)`` [m] and orientations ``(N, 4)``, w before xyz.
    """
    data = physics.data.ptr
    return np.array(data.xpos), np.array(data.xquat)


_PLANE, _SPHERE, _CYLINDER, _BOX, _MESH, _CAPSULE = (
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{name}")) for name in ("PLANE", "SPHERE", "CYLINDER", "BOX", "MESH", "CAPSULE")
)


def _colour(model: Any, index: int) -> Array:
    material = int(model.geom_matid[index])
    return model.geom_rgba[index, :3] if material < 0 else model.mat_rgba[material, :3]


def _mesh(model: Any, index: int) -> Mesh:
    """Vertices and triangles of a geom in its own frame."""
    kind, size = int(model.geom_type[index]), model.geom_size[index]
    if kind == _MESH:
        mesh = int(model.geom_dataid[index])
        first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        begin, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
        return np.array(model.mesh_vert[first : first + count], dtype=float), np.array(
            model.mesh_face[begin : begin + faces], dtype=np.int32
        )
    if kind == _BOX:
        return _CORNERS * size, _SIDES
    radius, half = float(size[0]), float(size[1]) if kind in (_CYLINDER, _CAPSULE) else 1e-4
    if kind not in (_CYLINDER, _CAPSULE, _SPHERE):
        raise ValueError(f"geom {model.geom(index).name!r} is of kind {kind}; expected a box, ball, cylinder or mesh.")
    shape = "cylinder" if kind == _CYLINDER else "tube"
    ends = ((0.0, 0.0, -half), (0.0, 0.0, half))
    return shell_mesh(Shell(0, shape, (1.0, 1.0, 1.0, 1.0), radius, *ends, edge=0.2 * min(radius, half)))
