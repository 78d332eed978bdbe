from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close

from ppt_rl.envs import PandaMazeEnv
from ppt_rl.envs.maze.layout import MazeLayout, Straight
from ppt_rl.functional.heading import from_heading
from ppt_rl.tasks.maze.config import maze_space
from ppt_rl.tasks.maze.follower import WallFollower
from tests.engines import COARSE
from tests.sampling import normal, random_poses
from tests.transforms.cases import sliding_env

ROWS = 20
POSE, HEADING = random_poses(ROWS), 2.0 * normal(ROWS, 1)
CLOSE: dict[str, Any] = {"rtol": 0.0, "atol": 1e-12}


def test_the_reference_is_ahead_of_the_tool_and_below_it_and_goes_ahead() -> None:
    position, velocity = WallFollower(maze_space(), lead=0.004, speed=0.05, depth=0.008).reference(POSE, HEADING)
    ahead = torch.tensor((0.004, 0.0, -0.008), dtype=torch.float64).expand(ROWS, 3)
    going = torch.tensor((0.05, 0.0, 0.0), dtype=torch.float64).expand(ROWS, 3)
    assert_close(position - POSE[:, :3], from_heading(ahead, HEADING), **CLOSE)
    assert_close(velocity, from_heading(going, HEADING), **CLOSE)


def test_the_action_is_the_reference_with_the_tool_upright_and_nothing_else_changes() -> None:
    space = maze_space()
    follower = WallFollower(space)
    td = TensorDict({"pose": POSE, "heading": HEADING}, [ROWS])
    out = follower(td.clone())
    position, velocity = follower.reference(POSE, HEADING)
    assert set(out.keys()) == {"pose", "heading", "action"}
    assert torch.equal(out["pose"], POSE)
    assert torch.equal(out["heading"], HEADING)
    assert_close(out["action"], torch.cat([space.pose(position), space.twist(velocity)], -1), **CLOSE)
    assert_close(out["action"][:, 3:7], torch.tensor(PandaMazeEnv.start_pose[3:]).double().expand(ROWS, 4), **CLOSE)


@pytest.mark.parametrize("name", ["lead", "speed", "depth"])
@pytest.mark.parametrize("value", [0.0, -0.01, float("nan"), float("inf")])
def test_a_number_that_is_not_positive_is_refused_by_name(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=rf"{name} is {value}; expected a finite number above 0"):
        WallFollower(maze_space(), **{name: value})


def test_it_reaches_the_end_of_straight_corridors() -> None:
    layouts = [
        MazeLayout((Straight(0.13),), start=start, heading=heading)
        for start, heading in (((0.45, -0.1), math.pi / 2), ((0.55, 0.0), -2.4))
    ]
    base = PandaMazeEnv.of(layouts, seed=0, duration=6.0, engine=COARSE)
    steps = sliding_env(base).rollout(330, WallFollower(maze_space()), break_when_all_done=True)["next"]
    assert steps["success"].any(1).all()
    assert not steps["left_corridor"].any()
    assert not steps["unsafe"].any()
