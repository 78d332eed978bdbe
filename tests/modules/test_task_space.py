import math

import pytest
import torch
from torch.testing import assert_close

from ppt_rl.functional.rotations import quat_conjugate, quat_multiply
from ppt_rl.modules import TaskSpace
from tests.sampling import normal, random_quats

F64 = torch.float64
TOOL_DOWN = (0.4, 0.0, 0.02, 0.0, 1.0, 0.0, 0.0)
TILTED = (0.4, -0.1, 0.3, *random_quats(seed=5).tolist())
each_space = pytest.mark.parametrize(
    "axes", [("x",), ("yaw",), ("x", "y", "yaw"), ("yaw", "z", "x", "y")], ids="-".join
)
each_origin = pytest.mark.parametrize("origin", [TOOL_DOWN, TILTED], ids=["tool down", "tilted"])


def coordinates(space: TaskSpace, *batch: int) -> torch.Tensor:
    """Coordinates with angles inside (-pi, pi)."""
    return normal(*batch, space.num_dof).clamp(-3.1, 3.1)


@each_origin
@each_space
@pytest.mark.parametrize("batch", [(), (50,), (2, 3)])
def test_project_undoes_pose(axes, origin, batch):
    space = TaskSpace(axes, origin).double()
    y = coordinates(space, *batch)
    pose = space.pose(y)
    assert pose.shape == (*batch, 7)
    assert_close(space.project(pose), y, rtol=0.0, atol=1e-6)  # the origin was stored in float32


def test_coordinates_that_are_not_named_keep_their_origin():
    pose = TaskSpace(("y",), TOOL_DOWN).pose(torch.tensor([[0.3]]))
    assert_close(pose, torch.tensor([[0.4, 0.3, 0.02, 0.0, 1.0, 0.0, 0.0]]))


def test_columns_follow_the_order_of_the_axes():
    y = torch.tensor([0.1, 0.2, 0.3])
    pose = TaskSpace(("z", "x", "y"), TOOL_DOWN).pose(y)
    assert_close(pose[:3], torch.tensor([0.2, 0.3, 0.1]))


def test_a_yaw_of_half_a_turn_turns_the_tool_about_the_world_z_axis():
    pose = TaskSpace(("yaw",), TOOL_DOWN).pose(torch.tensor([math.pi]))
    assert_close(pose[3:], torch.tensor([0.0, 0.0, 1.0, 0.0]))


@each_origin
@each_space
def test_twist_is_the_time_derivative_of_the_pose(axes, origin):
    space = TaskSpace(axes, origin).double()
    space.origin[3:] /= space.origin[3:].norm()
    y, velocity, h = coordinates(space, 50), normal(50, space.num_dof, seed=1), 1e-5
    before, after = space.pose(y - h * velocity), space.pose(y + h * velocity)
    turn = quat_multiply(after[:, 3:], quat_conjugate(before[:, 3:]))
    rotation = 2 * turn[:, 1:] * turn[:, :1].sign()  # rotation vector of a small turn, world axes
    expected = torch.cat([after[:, :3] - before[:, :3], rotation], -1) / (2 * h)
    assert_close(space.twist(velocity), expected, rtol=0.0, atol=1e-8)


def test_pose_keeps_the_precision_of_its_input():
    space = TaskSpace(("x", "yaw"), TOOL_DOWN)
    for dtype in (torch.float32, F64):
        assert space.pose(torch.zeros(2, dtype=dtype)).dtype == dtype
        assert space.twist(torch.zeros(2, dtype=dtype)).dtype == dtype


@pytest.mark.parametrize("axes", [(), ("x", "x"), ("x", "roll"), ("X",)])
def test_unknown_duplicate_or_missing_axes_are_refused(axes):
    with pytest.raises(ValueError, match="expected one or more distinct names from"):
        TaskSpace(axes, TOOL_DOWN)


def test_an_origin_that_is_not_a_pose_is_refused():
    with pytest.raises(ValueError, match=r"origin is \(0.0, 0.0, 0.0\); expected seven finite numbers"):
        TaskSpace(("x",), (0.0, 0.0, 0.0))


def test_the_wrong_number_of_coordinates_is_refused():
    with pytest.raises(ValueError, match="task-space position has shape"):
        TaskSpace(("x", "y"), TOOL_DOWN).pose(torch.zeros(3))


def test_only_the_yaw_of_a_difference_is_wrapped():
    space = TaskSpace(("x", "yaw"), (0.4, 0.0, 0.1, 0.0, 1.0, 0.0, 0.0))
    position = torch.tensor([[5.0, 3.1], [0.0, -3.1], [0.0, 0.3], [1.0, 9.0]], dtype=torch.float64)
    other = torch.tensor([[1.0, -3.1], [7.0, 3.1], [0.0, 0.1], [1.0, 0.0]], dtype=torch.float64)
    expected = torch.tensor(
        [[4.0, 6.2 - 2 * math.pi], [-7.0, 2 * math.pi - 6.2], [0.0, 0.2], [0.0, 9.0 - 2 * math.pi]], dtype=torch.float64
    )
    torch.testing.assert_close(space.difference(position, other), expected)


def test_a_difference_without_yaw_is_plain():
    space = TaskSpace(("x", "y"), (0.4, 0.0, 0.1, 0.0, 1.0, 0.0, 0.0))
    position, other = torch.tensor([[9.0, -9.0]]), torch.tensor([[-9.0, 9.0]])
    assert torch.equal(space.difference(position, other), position - other)
