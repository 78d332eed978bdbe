from __future__ import annotations

import numpy as np
import pytest

from ppt_rl.envs import MazeEnv, PushEnv
from ppt_rl.envs.drawn import body_poses, drawn_shapes
from tests.engines import COARSE


@pytest.fixture(scope="module")
def env():
    env = PushEnv(1, goal="pose", seed=0, engine=COARSE)
    env.reset()
    yield env
    env.close()


def turned(orientation, vectors):
    """Vectors turned by a quaternion, w before xyz."""
    w, u = orientation[0], orientation[1:]
    return vectors + 2 * np.cross(u, np.cross(u, vectors) + w * vectors)


def test_shapes_on_their_bodies_lie_where_the_simulator_has_them(env):
    physics = env.physics(0)
    model, data = physics.model.ptr, physics.data.ptr
    positions, orientations = body_poses(physics)
    for shape in drawn_shapes(physics):
        geom = int(shape.name.partition("_")[0])
        world = turned(orientations[shape.body], shape.vertices) + positions[shape.body]
        if not shape.flat:  # the bounding radius of a box is that of its size when it was compiled
            reach = np.linalg.norm(world - data.geom_xpos[geom], axis=-1)
            assert reach.max() <= model.geom_rbound[geom] * 1.01 + 1e-3
        np.testing.assert_allclose(0.5 * (world.max(0) + world.min(0)), data.geom_xpos[geom], atol=0.06)


def test_a_box_has_its_size_and_its_faces_point_outwards(env):
    physics = env.physics(0)
    (box,) = (shape for shape in drawn_shapes(physics) if shape.name.endswith("_box"))
    size = 2 * physics.model.ptr.geom("box").size
    np.testing.assert_allclose(np.ptp(box.vertices, axis=0), size)
    a, b, c = (box.vertices[box.triangles[:, corner]] for corner in range(3))
    assert np.einsum("fi,fi->f", a, np.cross(b, c)).sum() / 6 == pytest.approx(np.prod(size))
    assert (np.einsum("fi,fi->f", a, np.cross(b, c)) > 0).all()
    assert box.flat


def test_planes_and_what_is_invisible_are_left_out(env):
    names = {shape.name.partition("_")[2] for shape in drawn_shapes(env.physics(0))}
    assert not names & {"table", "ground"}
    assert {"slab", "stem", "bar", "outline0"} <= names
    position = PushEnv(1, goal="position", seed=0, engine=COARSE)
    position.reset()
    assert "outline0" not in {shape.name.partition("_")[2] for shape in drawn_shapes(position.physics(0))}
    position.close()


def test_a_maze_is_drawn_with_its_walls():
    env = MazeEnv.mazes(1, seed=0, engine=COARSE)
    env.reset()
    assert sum("wall" in shape.name for shape in drawn_shapes(env.physics(0))) > 4
    env.close()


def test_shapes_are_alike_if_their_form_and_their_colour_are(env):
    first, again = (drawn_shapes(env.physics(0)) for _ in range(2))
    assert all(a.is_like(b) for a, b in zip(first, again, strict=True))
    assert not first[0].is_like(None)
    assert not first[0].is_like(first[-1])
