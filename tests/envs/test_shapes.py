from __future__ import annotations

import math

import numpy as np
import pytest

from ppt_rl.arms import FR3, PANDA, UR5E, Shell
from ppt_rl.envs.models.shapes import shell_mesh

WHITE = (1.0, 1.0, 1.0, 1.0)
SHELLS = [shell for arm in (PANDA, FR3, UR5E) for shell in arm.shells]


def volume(vertices, triangles):
    a, b, c = (vertices[triangles[:, corner]] for corner in range(3))
    return float(np.einsum("fi,fi->f", a, np.cross(b, c)).sum() / 6)


@pytest.mark.parametrize("shell", SHELLS)
def test_every_shell_is_closed_and_its_triangles_face_outwards(shell):
    vertices, triangles = shell_mesh(shell)
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    ways = {tuple(edge) for edge in edges.tolist()}
    assert len(ways) == len(edges)  # no edge is passed twice in one direction
    assert all((b, a) in ways for a, b in ways)  # and each is passed in both
    assert volume(vertices, triangles) > 0
    assert np.isfinite(vertices).all()


def test_a_cylinder_reaches_from_start_to_end_and_has_its_volume():
    shell = Shell(0, "cylinder", WHITE, 0.05, (0.1, 0.0, 0.0), (0.1, 0.0, 0.2), edge=1e-4)
    vertices, triangles = shell_mesh(shell)
    assert np.ptp(vertices, axis=0) == pytest.approx([0.1, 0.1, 0.2], rel=0.01)
    assert volume(vertices, triangles) == pytest.approx(math.pi * 0.05**2 * 0.2, rel=0.02)


@pytest.mark.parametrize("edge", [0.002, 0.02, 5.0])
def test_a_rounded_edge_takes_volume_and_leaves_the_size(edge):
    sharp = shell_mesh(Shell(0, "cylinder", WHITE, 0.05, (0.0,) * 3, (0.0, 0.0, 0.2), edge=1e-6))
    rounded = shell_mesh(Shell(0, "cylinder", WHITE, 0.05, (0.0,) * 3, (0.0, 0.0, 0.2), edge=edge))
    assert volume(*rounded) < volume(*sharp)
    assert np.ptp(rounded[0], axis=0) == pytest.approx(np.ptp(sharp[0], axis=0))


def test_a_straight_tube_is_a_cylinder_with_half_a_ball_at_each_end():
    shell = Shell(0, "tube", WHITE, 0.05, (0.0, 0.0, 0.0), (0.2, 0.0, 0.0))
    expected = math.pi * 0.05**2 * 0.2 + 4 / 3 * math.pi * 0.05**3
    assert volume(*shell_mesh(shell)) == pytest.approx(expected, rel=0.05)


def test_a_bent_tube_starts_along_its_bend_and_tapers():
    shell = Shell(0, "tube", WHITE, 0.04, (0.0,) * 3, (0.2, 0.2, 0.0), via=(0.2, 0.0, 0.0), end_radius=0.02)
    vertices, _ = shell_mesh(shell)
    assert vertices[:, 0].min() == pytest.approx(-0.04, abs=1e-3)  # half a ball behind the start
    assert vertices[:, 1].max() == pytest.approx(0.22, abs=1e-3)  # and a smaller one beyond the end
    assert np.ptp(vertices[:, 2]) == pytest.approx(0.08, rel=0.02)


def test_a_shape_that_has_no_mesh_is_refused():
    with pytest.raises(ValueError, match=r"a shell is a 'capsule'; expected a 'cylinder' or a 'tube'"):
        shell_mesh(Shell(0, "capsule", WHITE, 0.04, (0.0,) * 3, (0.2, 0.2, 0.0)))
