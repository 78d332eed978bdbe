from __future__ import annotations

import numpy as np
import pytest

from ppt_rl.envs import PushEnv
from tests.engines import COARSE, model_of

SIZES = (0.06, 0.10)


def shown(goal: str, size: float):
    env = PushEnv(1, goal=goal, box_sizes=(size,), box_masses=(0.1,), seed=0, engine=COARSE)
    env.reset()
    return env, env.physics(0)


@pytest.mark.parametrize("size", SIZES)
def test_the_outline_of_a_pose_frames_a_box_that_stands_on_it(size):
    env, physics = shown("pose", size)
    half, model = 0.5 * size, physics.model.ptr
    inner = []
    for number in range(4):
        line = model.geom(f"outline{number}")
        axis = int(np.abs(line.pos[:2]).argmax())
        inner.append(abs(line.pos[axis]) - line.size[axis])
        assert line.rgba[3] == 1
    assert inner == pytest.approx([half] * 4)
    env.close()


def test_the_marked_side_of_the_outline_lies_along_the_yaw_of_the_goal_and_the_painted_face_along_that_of_the_box():
    env = PushEnv(1, goal="pose", seed=3, engine=COARSE)
    observed = env.reset()
    data = env.physics(0).data.ptr
    ahead = data.geom("outline0").xpos[:2] - data.body("goal").xpos[:2]
    assert np.arctan2(ahead[1], ahead[0]) == pytest.approx(float(observed["goal_yaw"]), abs=1e-5)
    w, _, _, z = observed["box_pose"][0, 3:].tolist()
    for mark in ("box_face", "box_edge"):
        ahead = data.geom(mark).xpos[:2] - data.body("box").xpos[:2]
        assert np.arctan2(ahead[1], ahead[0]) == pytest.approx(2 * np.arctan2(z, w), abs=1e-5)
    env.close()


def test_a_goal_that_is_a_position_has_no_outline():
    env, physics = shown("position", 0.06)
    assert [physics.model.ptr.geom(f"outline{number}").rgba[3] for number in range(4)] == [0] * 4
    env.close()


def test_the_simulated_model_has_no_marks():
    env, _ = shown("pose", 0.06)
    model = model_of(env, 0)
    names = {model.geom(number).name for number in range(model.ngeom)}
    assert not {name for name in names if name.startswith(("outline", "box_", "goal", "shell", "tip", "adapter"))}
    env.close()
