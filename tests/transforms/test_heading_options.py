"""Transforms that work in the world or, on request, in the frame of a tool on its heading."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torch.testing import assert_close
from torchrl.envs import TransformedEnv

from ppt_rl.functional.heading import from_heading
from ppt_rl.functional.promp import vec
from ppt_rl.modules import TaskSpace
from ppt_rl.tasks.maze.config import maze_space
from ppt_rl.transforms import CartesianVelocityTransform, ViaPointTransform
from tests.sampling import normal, random_poses
from tests.transforms.cases import ORIGIN, make_promp
from tests.transforms.mocks import ScriptedEnv, play

F64 = torch.float64
ROWS, POINTS = 4, 3
FRAME = ("pose", "heading")
CLOSE: dict[str, Any] = {"rtol": 0.0, "atol": 1e-9}


def via_points() -> TensorDict:
    """Via-points in world coordinates about tools on their headings; one of each row is masked."""
    poses, root = random_poses(ROWS), normal(ROWS, POINTS, 3, 3, seed=4)
    mask = torch.tensor([True, False, True]).expand(ROWS, POINTS).clone()
    return TensorDict(
        {
            "pose": poses,
            "heading": 2.0 * normal(ROWS, 1),
            "via_phase": torch.tensor((0.2, 0.5, 0.9), dtype=F64).expand(ROWS, POINTS).clone(),
            "via_position": poses[:, None, :3] + 0.1 * normal(ROWS, POINTS, 3, seed=1),
            "via_cov": 1e-3 * (root @ root.mT) + 1e-5 * torch.eye(3, dtype=F64),
            "via_mask": mask,
        },
        [ROWS],
    )


def moved(td: TensorDict, angle: float, shift: tuple[float, float, float]) -> TensorDict:
    """The same world turned and moved."""
    turn = torch.full((1, 1), angle, dtype=F64)
    out, by = td.clone(), torch.tensor(shift, dtype=F64)
    out["pose"] = torch.cat([from_heading(td["pose"][:, :3], turn) + by, td["pose"][:, 3:]], -1)
    out["heading"] = td["heading"] + angle
    out["via_position"] = from_heading(td["via_position"], turn.unsqueeze(0)) + by
    rotation = matrix(turn[0])
    out["via_cov"] = rotation @ td["via_cov"] @ rotation.T
    return out


def matrix(angle: Tensor) -> Tensor:
    """Rotation matrix about z, of one angle ``(1,)``."""
    cos, sin = float(angle.cos()), float(angle.sin())
    return torch.tensor([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]], dtype=F64)


# -- via-points --------------------------------------------------------------------------------------------------------


def test_the_posterior_in_a_frame_is_that_of_via_points_turned_by_hand() -> None:
    promp, td = make_promp(), via_points()
    out = ViaPointTransform(promp, write_cov=True, frame=FRAME)(td.clone())
    for row in range(ROWS):
        world_to_tool = matrix(td["heading"][row]).T
        position = (td["via_position"][row] - td["pose"][row, :3]) @ world_to_tool.T
        cov = world_to_tool @ td["via_cov"][row] @ world_to_tool.T
        posterior = promp.posterior(td["via_phase"][row], position, cov, td["via_mask"][row])
        assert_close(vec(out["weights_mean"][row]).float(), posterior.mean, rtol=0.0, atol=1e-6)
        assert_close(out["weights_cov"][row].float(), posterior.cov, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("angle", [-2.2, 0.4, math.pi])
def test_moving_and_turning_tool_and_via_points_together_leaves_the_posterior_as_it_is(angle: float) -> None:
    transform, td = ViaPointTransform(make_promp(), write_cov=True, frame=FRAME), via_points()
    here, there = transform(td.clone()), transform(moved(td, angle, (0.3, -0.2, 0.1)))
    assert_close(there["weights_mean"], here["weights_mean"], rtol=0.0, atol=1e-6)
    assert_close(there["weights_cov"], here["weights_cov"], rtol=0.0, atol=1e-6)
    alone = ViaPointTransform(make_promp())
    assert (alone(td.clone())["weights_mean"] - here["weights_mean"]).abs().max() > 1e-2


def test_the_frame_changes_nothing_but_the_posterior() -> None:
    td = via_points()
    out = ViaPointTransform(make_promp(), frame=FRAME)(td.clone())
    assert set(out.keys()) == {*td.keys(), "weights_mean"}
    assert all(torch.equal(out[key], td[key]) for key in td.keys())


def test_a_tool_at_the_origin_on_heading_zero_sees_the_via_points_as_they_are() -> None:
    td = via_points()
    td["pose"], td["heading"] = torch.zeros(ROWS, 7, dtype=F64), torch.zeros(ROWS, 1, dtype=F64)
    framed, plain = (ViaPointTransform(make_promp(), frame=frame)(td.clone()) for frame in (FRAME, None))
    assert_close(framed["weights_mean"], plain["weights_mean"], **CLOSE)


def test_via_velocities_are_turned_along_with_the_via_points() -> None:
    promp, td = make_promp(), via_points()
    heading = td["heading"].unsqueeze(-2)
    velocity = 0.2 * normal(ROWS, POINTS, 3, seed=6)  # in the frame
    td["via_velocity"] = from_heading(velocity, heading)
    td["via_velocity_cov"] = 1e-8 * torch.eye(3, dtype=F64).expand(ROWS, POINTS, 3, 3)
    td["via_velocity_mask"] = torch.tensor([False, False, True]).expand(ROWS, POINTS)
    out = ViaPointTransform(promp, frame=FRAME)(td)
    reached = promp.decode(out["weights_mean"], td["via_phase"])[1]
    assert_close(reached[:, 2], velocity[:, 2], rtol=0.0, atol=1e-2)


@pytest.mark.parametrize("key", FRAME)
def test_a_missing_observation_of_the_frame_is_named(key: str) -> None:
    with pytest.raises(KeyError, match=rf"ViaPointTransform needs .*{key}"):
        ViaPointTransform(make_promp(), frame=FRAME)(via_points().exclude(key))


# -- Cartesian velocity ------------------------------------------------------------------------------------------------

SPEED, DT = (0.3, 0.2, 0.1), 0.01


def driven(heading: Tensor, actions: Tensor, **kwargs: Any) -> Tensor:
    """References ``(B, T, 13)`` of tools that stand still, under actions ``(T, B, 3)``."""
    steps, rows = actions.shape[:2]
    pose = maze_space().pose(torch.tensor((0.5, 0.1, 0.02), dtype=F64)).expand(rows, steps + 1, 7)
    base = ScriptedEnv(13, pose=pose, heading=heading.unsqueeze(1).expand(rows, steps + 1, 1))
    transform = CartesianVelocityTransform(maze_space(), max_velocity=SPEED, max_lead=0.5, dt=DT, **kwargs)
    return play(TransformedEnv(base, transform), actions)["next", "executed"]


@pytest.mark.parametrize(("axis", "turn"), [(0, 0.0), (1, math.pi / 2)], ids=["ahead", "left"])
def test_an_action_ahead_or_to_the_left_moves_the_reference_that_way(axis: int, turn: float) -> None:
    heading = 2.0 * normal(5, 1)
    actions = torch.eye(3, dtype=F64)[axis].expand(4, 5, 3)
    references = driven(heading, actions, heading_key="heading")
    way = torch.cat([(heading + turn).cos(), (heading + turn).sin(), 0 * heading], -1)
    expected = torch.tensor((0.5, 0.1, 0.02), dtype=F64) + 4 * DT * SPEED[axis] * way
    assert_close(references[:, -1, :3], expected, rtol=0.0, atol=1e-7)


def test_an_action_upwards_is_the_same_on_every_heading() -> None:
    references = driven(2.0 * normal(5, 1), torch.eye(3, dtype=F64)[2].expand(4, 5, 3), heading_key="heading")
    assert_close(references, references[:1].expand_as(references), **CLOSE)
    assert_close(references[:, -1, 2], torch.full((5,), 0.02 + 4 * DT * SPEED[2], dtype=F64), rtol=0.0, atol=1e-7)


def test_on_heading_zero_an_action_is_a_velocity_in_world_axes() -> None:
    actions, ahead = normal(6, 5, 3), torch.zeros(5, 1, dtype=F64)
    assert torch.equal(driven(ahead, actions, heading_key="heading"), driven(ahead, actions))


@pytest.mark.parametrize("axes", [("x", "y", "yaw"), ("x", "y"), ("y", "x", "z")])
def test_a_heading_needs_the_task_space_of_x_y_z(axes: tuple[str, ...]) -> None:
    with pytest.raises(ValueError, match=r"task_space has the coordinates .*expected \('x', 'y', 'z'\)"):
        CartesianVelocityTransform(TaskSpace(axes, ORIGIN), heading_key="heading")


def test_a_missing_heading_is_named() -> None:
    td = TensorDict({"pose": random_poses(2), "action": torch.zeros(2, 3, dtype=F64)}, [2])
    with pytest.raises(KeyError, match=r"CartesianVelocityTransform needs \['heading'\]; the tensordict holds .*pose"):
        CartesianVelocityTransform(maze_space(), heading_key="heading").inv(td)
