import copy
import functools
import math

import pytest
import torch
from torch.testing import assert_close

from ppt_rl.arms import FR3, PANDA, UR5E, Arm, arm_names, find_arm
from ppt_rl.envs.models import CYLINDER, PADDLE, table_scene
from ppt_rl.envs.mujoco_imports import mjcf, mujoco
from ppt_rl.functional.rotations import quat_conjugate, quat_from_yaw, quat_multiply, quat_to_matrix
from ppt_rl.modules import Kinematics
from tests.sampling import normal, random_joint_positions

F32, F64 = torch.float32, torch.float64
HOME = torch.tensor(PANDA.home, dtype=F64)
ARMS = [find_arm(name) for name in arm_names()]


@pytest.fixture(scope="module")
def kinematics() -> Kinematics:
    return Kinematics(PANDA, PADDLE.length, dtype=F64)


@functools.cache
def mujoco_truth(arm: Arm) -> tuple[torch.Tensor, ...]:
    """1000 joint positions inside the limits with MuJoCo's site position, site matrix and site Jacobian."""
    physics = mjcf.Physics.from_mjcf_model(table_scene(arm))
    model, data = physics.model.ptr, physics.data.ptr
    site = physics.model.name2id("end_effector", "site")
    joint_position = random_joint_positions(1000, arm=arm)
    position, matrix, jacobian = torch.zeros(1000, 3), torch.zeros(1000, 3, 3), torch.zeros(1000, 6, arm.num_joints)
    position, matrix, jacobian = position.double(), matrix.double(), jacobian.double()
    for i, q in enumerate(joint_position.numpy()):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        position[i] = torch.from_numpy(data.site_xpos[site].copy())
        matrix[i] = torch.from_numpy(data.site_xmat[site].reshape(3, 3).copy())
        mujoco.mj_jacSite(model, data, jacobian[i, :3].numpy(), jacobian[i, 3:].numpy(), site)
    return joint_position, position, matrix, jacobian


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
@pytest.mark.parametrize(("dtype", "atol"), [(F32, 1e-5), (F64, 1e-12)], ids=["float32", "float64"])
def test_pose_and_jacobian_agree_with_mujoco(arm, dtype, atol):
    joint_position, position, matrix, jacobian = mujoco_truth(arm)
    pose, own_jacobian = Kinematics(arm, PADDLE.length, dtype=dtype)(joint_position.to(dtype))
    for own, true in ((pose[:, :3], position), (quat_to_matrix(pose[:, 3:]), matrix), (own_jacobian, jacobian)):
        assert own.dtype == dtype
        assert_close(own.double(), true, rtol=0.0, atol=atol)


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_at_home_the_tool_points_down_in_front_of_the_base(arm):
    pose, _ = Kinematics(arm, PADDLE.length, dtype=F64)(torch.tensor(arm.home, dtype=F64))
    assert_close(quat_to_matrix(pose[3:]), torch.diag(torch.tensor([1.0, -1.0, -1.0], dtype=F64)), rtol=0.0, atol=1e-12)
    assert pose[0].item() > 0.3
    assert pose[1].item() == pytest.approx(0.0, abs=1e-12)


def test_a_longer_tool_moves_the_point_along_the_tools_axis(kinematics):
    q = random_joint_positions(20)
    near, far = kinematics(q)[0], Kinematics(PANDA, PADDLE.length + 0.1, dtype=F64)(q)[0]
    axis = quat_to_matrix(near[:, 3:])[:, :, 2]
    assert_close(far[:, :3] - near[:, :3], 0.1 * axis, rtol=0.0, atol=1e-12)
    assert_close(far[:, 3:], near[:, 3:], rtol=0.0, atol=1e-12)


def test_the_jacobian_method_equals_the_jacobian_of_forward(kinematics):
    q = random_joint_positions(5)
    assert torch.equal(kinematics.jacobian(q), kinematics(q)[1])


def test_the_linear_jacobian_is_the_derivative_of_the_position(kinematics):
    q = random_joint_positions(10).requires_grad_()
    pose, jacobian = kinematics(q)
    rows = [torch.autograd.grad(pose[:, i].sum(), q, retain_graph=True)[0] for i in range(3)]
    assert_close(torch.stack(rows, 1), jacobian[:, :3], rtol=0.0, atol=1e-12)


def test_the_angular_jacobian_is_the_derivative_of_the_orientation(kinematics):
    q = random_joint_positions(10).requires_grad_()
    pose, jacobian = kinematics(q)
    rows = [torch.autograd.grad(pose[:, i].sum(), q, retain_graph=True)[0] for i in range(3, 7)]
    inverse = quat_conjugate(pose[:, 3:]).unsqueeze(-2).expand(10, 7, 4)
    spin = 2 * quat_multiply(torch.stack(rows, -1), inverse)[..., 1:]  # omega = 2 dq q*
    assert_close(spin.mT, jacobian[:, 3:], rtol=0.0, atol=1e-12)


def test_first_derivatives_of_pose_and_jacobian_are_right(kinematics):
    assert torch.autograd.gradcheck(kinematics, (random_joint_positions(2).requires_grad_(),))


def test_second_derivatives_of_pose_and_jacobian_are_right(kinematics):
    q = random_joint_positions(1, seed=1).requires_grad_()
    assert torch.autograd.gradgradcheck(kinematics, (q,), rtol=1e-4)


@pytest.mark.parametrize("batch", [(), (3,), (2, 3)])
def test_batched_rows_equal_single_calls(kinematics, batch):
    q = random_joint_positions(*batch)
    pose, jacobian = kinematics(q)
    assert pose.shape == (*batch, 7)
    assert jacobian.shape == (*batch, 6, 7)
    singles = [kinematics(row) for row in q.reshape(-1, 7)]
    assert_close(pose.reshape(-1, 7), torch.stack([single[0] for single in singles]))
    assert_close(jacobian.reshape(-1, 6, 7), torch.stack([single[1] for single in singles]))


def test_moving_to_double_gives_full_double_precision(kinematics):
    q = random_joint_positions(10)
    for moved in (Kinematics(PANDA, PADDLE.length).to(F64), copy.deepcopy(Kinematics(PANDA, PADDLE.length)).double()):
        pose, jacobian = moved(q)
        assert pose.dtype == jacobian.dtype == F64
        assert_close((pose, jacobian), kinematics(q), rtol=0.0, atol=1e-14)


def test_inputs_are_cast_to_the_modules_precision():
    pose, jacobian = Kinematics(PANDA, 0.1)(random_joint_positions(2))
    assert pose.dtype == jacobian.dtype == F32


def test_it_has_no_state_to_save(kinematics):
    assert not kinematics.state_dict()


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
@pytest.mark.parametrize("dtype", [F32, F64])
def test_inverse_kinematics_reaches_poses_near_the_guess_inside_the_limits(arm, dtype):
    kinematics, home = Kinematics(arm, PADDLE.length, dtype=dtype), torch.tensor(arm.home, dtype=dtype)
    wanted, _ = kinematics(home + 0.15 * normal(30, arm.num_joints).to(dtype))
    found = kinematics.inverse(wanted, home.expand(30, -1))
    reached, _ = kinematics(found)
    assert_close(reached[:, :3], wanted[:, :3], rtol=0.0, atol=1e-4)
    assert bool(((reached[:, 3:] * wanted[:, 3:]).sum(-1).abs() > math.cos(0.5e-4) - 1e-6).all())
    low, high = torch.tensor(arm.joints.position_limits, dtype=dtype).unbind(-1)
    assert bool(((found >= low) & (found <= high)).all())


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_an_upright_tool_reaches_the_arms_reach_at_the_tables_height(arm):
    radius, bearing = torch.linspace(*arm.reach, 5, dtype=F64), torch.linspace(-1.0, 1.0, 5, dtype=F64)
    radius, bearing = torch.meshgrid(radius, bearing, indexing="ij")
    place = torch.stack([radius * bearing.cos(), radius * bearing.sin()], -1).reshape(-1, 2)
    down = torch.tensor([0.0, 0.0, 1.0, 0.0, 0.0], dtype=F64).expand(len(place), 5)
    kinematics, home = Kinematics(arm, CYLINDER.length, dtype=F64), torch.tensor(arm.home, dtype=F64)
    pose, _ = kinematics(kinematics.inverse(torch.cat([place, down], -1), home.expand(len(place), -1), iterations=300))
    assert_close(pose[:, :2], place, rtol=0.0, atol=1e-4)


def test_inverse_kinematics_of_a_reached_pose_is_the_guess(kinematics):
    guess = random_joint_positions(5)
    assert_close(kinematics.inverse(kinematics(guess)[0], guess), guess, rtol=0.0, atol=1e-12)


def test_inverse_kinematics_counts_the_poses_out_of_reach(kinematics):
    pose = kinematics(HOME)[0].repeat(3, 1)
    pose[1, 0] += 2.0
    with pytest.raises(ValueError, match="no joint position found for 1 of the poses"):
        kinematics.inverse(pose, HOME.expand(3, 7))


def test_inverse_kinematics_does_not_take_the_opposite_orientation_for_the_wanted_one(kinematics):
    pose = kinematics(HOME)[0].clone()
    pose[3:] = quat_multiply(quat_from_yaw(torch.tensor(math.pi, dtype=F64)), pose[3:])
    with pytest.raises(ValueError, match="no joint position found for 1 of the poses"):
        kinematics.inverse(pose, HOME)


@pytest.mark.parametrize("shape", [(), (6,), (2, 8)])
def test_a_joint_position_that_has_not_seven_numbers_is_refused(kinematics, shape):
    with pytest.raises(ValueError, match=r"joint_position has shape .*; expected \(\*batch, 7\)"):
        kinematics(torch.zeros(shape))


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_the_inertia_matrix_agrees_with_mujoco(arm):
    root = table_scene(arm)
    root.find("body", "tool").remove()
    for sensor in list(root.sensor.all_children()):
        sensor.remove()
    physics = mjcf.Physics.from_mjcf_model(root)
    model, data = physics.model.ptr, physics.data.ptr
    positions = random_joint_positions(20, arm=arm)
    own = Kinematics(arm, PADDLE.length, dtype=F64).inertia(positions.reshape(4, 5, -1)).flatten(0, 1)
    true = torch.zeros_like(own)
    for q, matrix in zip(positions.numpy(), true, strict=True):
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, matrix.numpy())
    assert_close(own, true, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("arm", [PANDA, FR3, UR5E], ids=lambda arm: arm.name)
def test_pose_and_jacobian_are_those_of_the_chain_of_pytorch_kinematics(arm):
    kinematics = Kinematics(arm, tool_length=0.15, dtype=torch.float64)
    low, high = torch.tensor(arm.joints.position_limits, dtype=torch.float64).unbind(-1)
    joints = low + (high - low) * torch.rand(64, arm.num_joints, dtype=torch.float64)
    pose, jacobian = kinematics(joints)
    matrix = kinematics.chain.forward_kinematics(joints).get_matrix()
    assert_close(pose[:, :3], matrix[:, :3, 3], rtol=0, atol=1e-12)
    assert_close(quat_to_matrix(pose[:, 3:]), matrix[:, :3, :3], rtol=0, atol=1e-12)
    assert_close(jacobian, kinematics.chain.jacobian(joints), rtol=0, atol=1e-12)
