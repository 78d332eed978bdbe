from __future__ import annotations

import math

import numpy as np
import pytest

from ppt_rl.arms import PANDA
from ppt_rl.envs.maze.feasibility import check_corridor
from ppt_rl.envs.maze.geometry import build_corridor
from ppt_rl.envs.maze.layout import MazeLayout, Straight, Turn
from tests.envs.maze.mazes import along, random_mazes, random_straights

LOOP = (Straight(0.15), *(Turn(math.radians(75)), Straight(0.15)) * 5)


def test_a_feasible_maze_has_its_corners_within_reach_and_nothing_much_nearer_to_the_base() -> None:
    for layout, corridor in [*random_mazes(), *random_straights()]:
        check_corridor(corridor, layout, PANDA.reach)
        corners = np.linalg.norm(corridor.centre[:, :2], axis=-1)
        assert PANDA.reach.low <= corners.min() <= corners.max() <= PANDA.reach.high
        assert np.linalg.norm(along(corridor, 20)[0][:, :2], axis=-1).min() >= 0.24


@pytest.mark.parametrize(
    ("layout", "message"),
    [
        (MazeLayout((Straight(1.0),)), r"the maze lies .* m from the base; expected 0.3 to 0.7 m, .*Move its start"),
        (MazeLayout((Straight(0.2),), start=(0.1, 0.4), heading=0.0), r"in front of it \(x above 0.15 m\)"),
        (MazeLayout((Straight(0.6),), start=(0.2, -0.3)), r"the maze lies .* m from the base; expected 0.3 to 0.7 m"),
        (MazeLayout(LOOP, start=(0.55, -0.1)), r"The maze crosses itself, or a straight is too short for its corners"),
        (
            MazeLayout((Straight(0.15), *(Turn(1.2), Straight(0.03), Turn(1.2)), Straight(0.15)), start=(0.55, -0.1)),
            r"The maze crosses itself, or a straight is too short for its corners",
        ),
        (
            MazeLayout((Straight(0.2), *(Turn(1.3), Straight(0.05), Turn(1.3)), Straight(0.2)), start=(0.5, -0.1)),
            r"two stretches of the maze meet near \(.*\); expected at least 8 mm between",
        ),
        (MazeLayout((Straight(0.12, rise=0.04),), start=(0.5, -0.1)), r"a ramp rises 0.040 m over 0.050 m; .* 25 deg"),
        (MazeLayout((Straight(0.25, rise=-0.04),), start=(0.5, -0.1)), r"the floor goes down to -0.040 m, .*Raise the"),
    ],
    ids=[
        "too far", "beside the base", "past the base", "loop", "short between turns", "back beside itself", "steep",
        "into the table",
    ],
)  # fmt: skip
def test_what_cannot_be_driven_through_is_refused(layout: MazeLayout, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        check_corridor(build_corridor(layout), layout, PANDA.reach)
