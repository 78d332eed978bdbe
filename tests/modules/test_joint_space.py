import math

import pytest
import torch
from torch.testing import assert_close

from ppt_rl.modules import JointSpace, TaskSpace


@pytest.mark.parametrize("batch", [(), (50,), (2, 3)], ids=str)
def test_the_coordinates_are_the_joint_positions_themselves(batch):
    space, q = JointSpace(3), torch.randn(*batch, 3)
    for same in (space.pose(q), space.twist(q), space.project(q)):
        assert torch.equal(same, q)


def test_it_offers_what_a_task_space_offers():
    public = {name for name in vars(TaskSpace) if not name.startswith("_")}
    assert all(hasattr(JointSpace(2), name) for name in public)
    assert JointSpace(2).axes == ("joint1", "joint2")
    assert JointSpace(2).num_dof == 2


def test_a_difference_takes_the_shorter_way_for_continuous_joints_only():
    space = JointSpace(2, continuous=(1,))
    difference = space.difference(torch.tensor([3.1, 3.1]), torch.tensor([-3.1, -3.1]))
    assert_close(difference, torch.tensor([6.2, 6.2 - 2 * math.pi]))


def test_it_is_cast_and_saved_without_numbers_of_its_own():
    space = JointSpace(2, continuous=(0,)).double()
    assert space.state_dict() == {}
    assert space.difference(torch.zeros(2), torch.ones(2)).dtype is torch.float32


@pytest.mark.parametrize("use", ["pose", "twist", "project"])
def test_a_wrong_number_of_joints_is_refused(use):
    with pytest.raises(ValueError, match=r"joint \w+ of JointSpace\(2\) has shape \(4, 3\); expected \(\*batch, 2\)"):
        getattr(JointSpace(2), use)(torch.zeros(4, 3))


@pytest.mark.parametrize("continuous", [(2,), (-1,), (0, 5), (True,)], ids=str)
def test_a_continuous_joint_that_there_is_not_is_refused(continuous):
    with pytest.raises(ValueError, match=r"continuous is .*; expected indices of joints, 0 to 1"):
        JointSpace(2, continuous)


def test_a_space_without_joints_is_refused():
    with pytest.raises(ValueError, match="num_dof is 0; expected at least 1 joint"):
        JointSpace(0)
