"""A tool dragged through the paper's maze."""

from __future__ import annotations

import numpy as np
import pytest
from tensordict import TensorDict
from torch.testing import assert_close

from ppt_rl.envs import MazeRewards, PandaMazeEnv
from ppt_rl.envs.maze.geometry import build_corridor
from ppt_rl.envs.maze.layout import paper_layout
from tests.engines import COARSE
from tests.envs.maze.mazes import (
    drag,
    travelled,
    walk,
)


@pytest.fixture(scope="module")
def driven() -> tuple[PandaMazeEnv, TensorDict]:
    """The paper's maze with a tool dragged along its centre line."""
    rewards = MazeRewards(progress=2.0, success=5.0)
    env = PandaMazeEnv.of([paper_layout()], rewards=rewards, seed=0, engine=COARSE)
    return env, drag(env, 0.10, [0.007], 14.0)[:, 0]


def test_a_tool_dragged_along_the_centre_line_gets_through_the_papers_maze(
    driven: tuple[PandaMazeEnv, TensorDict],
) -> None:
    run = driven[1]
    for name in ("success", "done", "terminated"):
        assert run[name].squeeze(-1).tolist() == [False] * (len(run) - 1) + [True], name
    for name in ("left_corridor", "unsafe", "truncated", "diverged"):
        assert not run[name].any(), name


def test_progress_grows_from_near_zero_to_one_along_the_centre_line(driven: tuple[PandaMazeEnv, TensorDict]) -> None:
    progress = driven[1]["progress"].squeeze(-1)
    assert 0 < float(progress[0]) < 0.05
    assert (progress.diff() > -1e-4).all()
    assert float(progress[-1]) == 1.0


def test_the_tool_stays_on_the_floor_on_ramps_up_and_down(driven: tuple[PandaMazeEnv, TensorDict]) -> None:
    env, run = driven
    centre = build_corridor(paper_layout()).centre
    distance = run["progress"].squeeze(-1).double().numpy() * travelled(centre)[-1]
    above = run["pose"][:, 2].double().numpy() - np.interp(distance, travelled(centre), centre[:, 2])
    slope = 0.04 / (0.19 - 0.07)
    assert above.min() > -2e-3
    assert above.max() < env.tool.stem_radius * slope + 3e-3  # on its edge
    assert run["pose"][:, 2].max() > 0.04


def test_the_privileged_observations_are_the_tools_offset_and_the_corridors_heading(
    driven: tuple[PandaMazeEnv, TensorDict],
) -> None:
    env, run = driven
    assert (run["corridor_offset"].abs() <= 0.5 * 0.055 - env.tool.stem_radius + 1e-3).all()
    headings = [heading for _, _, heading in walk(paper_layout())]
    seen_headings = sorted({round(float(value), 4) for value in run["corridor_heading"]})
    assert seen_headings == pytest.approx(sorted({round(value, 4) for value in headings}), abs=2e-4)


def test_the_progress_terms_add_up_to_the_distance_travelled_plus_the_bonus_for_the_end(
    driven: tuple[PandaMazeEnv, TensorDict],
) -> None:
    run = driven[1]
    total = run["reward_terms", "progress"].sum()
    assert_close(total, 2.0 * (1.0 - run["progress"][0, 0]) + 5.0, rtol=0, atol=1e-3)


def test_the_reward_is_the_sum_of_its_terms(driven: tuple[PandaMazeEnv, TensorDict]) -> None:
    run = driven[1][1:]
    terms = run["reward_terms"]
    assert set(terms.keys()) == {"progress", "free_space", "contact", "power"}
    assert_close(run["reward"], sum(terms.values()), rtol=0, atol=1e-5)
    for name in terms.keys():
        assert (terms[name] != 0).any(), name
    assert (terms["contact"] <= 0).all()
    assert (terms["power"] <= 0).all()
