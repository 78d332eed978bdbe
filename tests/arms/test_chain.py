from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from ppt_rl.arms import UR5E, Chain, DHRow
from ppt_rl.arms import ur5e as ur5e_file
from ppt_rl.envs.models import arm_model
from ppt_rl.envs.mujoco_imports import mjcf, mujoco
from ppt_rl.functional.rotations import quat_to_matrix
from ppt_rl.modules import Kinematics
from tests.sampling import random_joint_positions

CLOSE = {"rtol": 0, "atol": 1e-12}


def turn_x(angle):
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1.0]])


def turn_z(angle):
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])


def shift(x=0.0, z=0.0):
    matrix = np.eye(4)
    matrix[:3, 3] = x, 0.0, z
    return matrix


def modified(row, q):
    """A step of the modified convention, as textbooks write it."""
    return turn_x(row.alpha) @ shift(x=row.a) @ turn_z(q + row.theta) @ shift(z=row.d)


def standard(row, q):
    """A step of the standard convention, as textbooks write it."""
    return turn_z(q + row.theta) @ shift(z=row.d) @ shift(x=row.a) @ turn_x(row.alpha)


def along(chain, position):
    """Pose of the flange, as a product of the chain's offsets and rotations about z."""
    pose = np.eye(4)
    for offset, q in zip(chain.offsets, position, strict=True):
        fixed = turn_x(offset.twist) @ turn_z(offset.turn)
        fixed[:3, 3] = offset.position
        pose = pose @ fixed @ turn_z(q)
    return pose @ shift(z=chain.flange)


ROWS = [DHRow(0.1, 0.3, 0.4, 0.5), DHRow(-0.2, 0.1, -1.2), DHRow(0.3, -0.2, 0.9, -2.0), DHRow(0.0, 0.15, 0.0, 0.7)]


def product(step, position):
    return np.linalg.multi_dot([step(row, q) for row, q in zip(ROWS, position, strict=True)])


def test_a_chain_of_a_modified_table_is_the_product_of_its_steps():
    position = np.random.default_rng(0).uniform(-3, 3, len(ROWS))
    expected = product(modified, position) @ shift(z=0.2)
    np.testing.assert_allclose(along(Chain.modified_dh(ROWS, flange=0.2), position), expected, **CLOSE)


def test_a_chain_of_a_standard_table_is_the_product_of_its_steps():
    position = np.random.default_rng(0).uniform(-3, 3, len(ROWS))
    np.testing.assert_allclose(along(Chain.standard_dh(ROWS), position), product(standard, position), **CLOSE)


@pytest.mark.parametrize("row", [DHRow(0.1, 0.15, 0.0), DHRow(0.0, 0.15, 0.1)])
def test_a_standard_table_whose_flange_is_off_the_last_axis_is_refused(row):
    with pytest.raises(ValueError, match=r"the last row is .* expected a = 0 and alpha = 0"):
        Chain.standard_dh([*ROWS[:-1], row])


def test_the_kinematics_of_the_ur5e_agree_with_the_closed_form_of_its_table():
    q = random_joint_positions(200, arm=UR5E)
    pose, _ = Kinematics(UR5E, 0.0, dtype=torch.float64)(q)
    (s1, _, _, _, s5, s6), (c1, c2, _, _, c5, c6) = q.sin().unbind(-1), q.cos().unbind(-1)
    s2, q23, q234 = q[:, 1].sin(), q[:, 1:3].sum(-1), q[:, 1:4].sum(-1)
    s234, c234 = q234.sin(), q234.cos()
    axis = torch.stack([s1 * c5 - c1 * c234 * s5, -c1 * c5 - s1 * c234 * s5, -s234 * s5], -1)
    out, up = -0.425 * c2 - 0.3922 * q23.cos(), -0.425 * s2 - 0.3922 * q23.sin()
    wrist = torch.stack(
        [0.0997 * c1 * s234 + 0.1333 * s1 + c1 * out, 0.0997 * s1 * s234 - 0.1333 * c1 + s1 * out, -0.0997 * c234 + up],
        -1,
    )
    position = wrist + 0.0996 * axis + torch.tensor([0.0, 0.0, 0.1625], dtype=torch.float64)
    # Row 3 of the rotation is enough beside the axis: the matrix is orthogonal, and the tool is turned by -90 degrees.
    x_up, y_up = c6 * s234 * c5 + s6 * c234, -s6 * s234 * c5 + c6 * c234
    matrix = quat_to_matrix(pose[:, 3:])
    torch.testing.assert_close(pose[:, :3], position, **CLOSE)
    torch.testing.assert_close(matrix[:, :, 2], axis, **CLOSE)
    torch.testing.assert_close(matrix[:, 2, :2], torch.stack([-y_up, x_up], -1), **CLOSE)


def test_the_links_of_the_ur5e_move_as_those_of_its_table():
    model = mjcf.Physics.from_mjcf_model(arm_model(UR5E)).model.ptr
    data = mujoco.MjData(model)
    for position in random_joint_positions(20, arm=UR5E).numpy():
        data.qpos[:] = position
        mujoco.mj_kinematics(model, data)
        frame = np.eye(4)
        for index, (row, link) in enumerate(zip(ur5e_file._ROWS, ur5e_file._LINKS, strict=True), start=1):
            frame = frame @ standard(row, position[index - 1])
            xx, yy, zz, xy, xz, yz = link.inertia
            inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            body = data.body(f"link{index}")
            principal = body.ximat.reshape(3, 3)
            np.testing.assert_allclose(body.xipos, (frame @ [*link.com, 1.0])[:3], **CLOSE)
            np.testing.assert_allclose(
                principal @ np.diag(model.body(f"link{index}").inertia) @ principal.T,
                frame[:3, :3] @ inertia @ frame[:3, :3].T, rtol=0, atol=1e-9,
            )  # fmt: skip
