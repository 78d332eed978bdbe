"""Box pushing with obstacles: forces against independent oracles, and episodes that stay those of the seed.

Only the engine on CPU threads can follow contacts one by one, so every environment here names it.
"""

from typing import Any

import numpy as np
import pytest
import torch
from torch.testing import assert_close
from torchrl.envs import Compose, TransformedEnv
from torchrl.envs.utils import check_env_specs

from ppt_rl.envs import PushEnv
from ppt_rl.envs.mujoco_imports import mujoco
from ppt_rl.envs.push import HAND, WALL, Obstacle, ObstructedPushEnv
from ppt_rl.envs.readings import sensor_span
from ppt_rl.modules import CartesianImpedanceController, Kinematics
from ppt_rl.tasks.push import PRIVILEGED
from ppt_rl.tasks.push.scenarios import SCENARIOS
from ppt_rl.transforms import ImpedanceTransform, JointTorqueTransform

STIFFNESS = 400.0
THREADS: dict[str, Any] = {"engine": "threads"}
OBSTACLES = {scenario.name: scenario.make_env.keywords["obstacle"] for scenario in SCENARIOS}
ADDED = {
    "peak_force", "static_force", "pressure_force", "contact_time", "contact_speed", "contact", "held_force", "kind",
}  # fmt: skip


def controlled(obstacle, num_envs=2, duration=1.5, **settings):
    """An arm that follows a reference, in float64."""
    settings |= {"seed": 3, "dtype": torch.float64, "engine": "threads"}
    base = ObstructedPushEnv(num_envs, obstacle=obstacle, duration=duration, **settings)
    controller = CartesianImpedanceController((*(STIFFNESS,) * 3, 30.0, 30.0, 30.0)).double()
    kinematics = Kinematics(base.arm, base.tool_length, dtype=torch.float64)
    return TransformedEnv(base, Compose(JointTorqueTransform(kinematics), ImpedanceTransform(controller)))


def push_ahead(env, lead, speed=0.25, steps=150):
    """Move the reference along the normal of the first plate until it is ``lead`` behind its front, and on and on."""
    base = env.base_env
    tensordict = env.reset()
    start, heading = tensordict["pose"].clone(), torch.from_numpy(base._heading)
    ahead = torch.stack([heading.cos(), heading.sin(), torch.zeros_like(heading)], -1)
    front = torch.from_numpy(base._front[:, 0])
    start[:, :2] = (front - 0.12 * ahead)[:, :2]  # straight before the plate
    reach = 0.12 + lead
    for step in range(steps):
        travelled = min(speed * max(0.0, 0.01 * step - 0.5), reach)
        moving = step > 50 and travelled < reach
        pose = torch.cat([start[:, :3] + travelled * ahead, start[:, 3:]], -1)
        twist = torch.cat([(speed if moving else 0.0) * ahead, torch.zeros_like(ahead)], -1)
        tensordict = env.step(tensordict.set("action", torch.cat([pose, twist], -1)))["next"]
    return tensordict, pose


def test_the_static_force_on_a_wall_is_stiffness_times_lead_and_what_mujoco_says():
    env = controlled(Obstacle((WALL,)), duration=3.0)
    end, reference = push_ahead(env, lead=0.1, steps=300)
    pulled = STIFFNESS * (reference - end["pose"])[:, :3].norm(dim=-1, keepdim=True)
    assert (pulled > 30).all()
    assert_close(end["static_force"], pulled, rtol=0.02, atol=0.0)
    for row in range(2):
        physics = env.base_env.physics(row)
        model, data = physics.model.ptr, physics.data.ptr
        spring = model.joint("plate0_spring")
        along_normal = WALL.stiffness * data.qpos[spring.qposadr[0]]
        assert along_normal == pytest.approx(float(end["static_force"][row]), rel=0.03)
        total, force = np.zeros(3), np.zeros(6)
        for index in range(data.ncon):
            contact = data.contact[index]
            if model.geom("plate0").id in (contact.geom1, contact.geom2):
                mujoco.mj_contactForce(model, data, index, force)
                total += contact.frame.reshape(3, 3).T @ force[:3]
        assert np.linalg.norm(total) == pytest.approx(float(end["static_force"][row]), rel=0.03)


def test_the_momentum_of_a_free_hand_is_the_impulse_on_it():
    env = controlled(Obstacle((HAND,), clamped=(False,)))
    base = env.base_env
    model = base.engine.models[0]
    normal = sensor_span(model, "plate0_force", "plate0_force").start  # x of the pad, which points at the hand
    engine, impulse = base._contact._engine, np.zeros(2)
    step = engine.step

    def recording(control, mask=None):
        result = step(control, mask)
        impulse[:] -= result.sensors[:, :, normal].sum(1).numpy() * 0.0005
        return result

    engine.step = recording
    end, _ = push_ahead(env, lead=0.1)
    velocity = np.asarray([_mount(base, row)[1] for row in range(2)])
    assert (velocity > 0.1).all()
    np.testing.assert_allclose(impulse, HAND.mass * velocity, rtol=0.02)
    assert (end["peak_force"] > 10).all()
    assert (end["static_force"] < 1).all(), "a hand that moves away is not pressed"


def _mount(env, row):
    """Position and velocity of the mass behind the first plate."""
    model, state = env.engine.models[row], env.engine.state(row)
    joint = model.joint("plate0_mount")
    return state[1 + joint.qposadr[0]], state[1 + model.nq + joint.dofadr[0]]


def test_kinds_take_turns_and_a_clamped_hand_stays():
    env = controlled(Obstacle((HAND,), clamped=(True, False)), num_envs=2)
    end, _ = push_ahead(env, lead=0.05)
    assert end["kind"].tolist() == [[0.0], [1.0]]
    moved = [_mount(env.base_env, row)[0] for row in range(2)]
    assert abs(moved[0]) < 1e-4
    assert moved[1] > 0.02
    assert end["static_force"][0] > 10
    assert env.reset()["kind"].tolist() == [[1.0], [0.0]], "the next episode of a row is of the other kind"


def test_a_stop_vanishes_after_contact_and_what_stands_behind_is_struck():
    env = controlled(Obstacle((WALL, WALL), along=0.3, hold=(0.1, 0.1)), duration=2.0)
    end, _ = push_ahead(env, lead=0.1, steps=200)
    assert (end["held_force"] > 10).all()
    assert (end["peak_force"] > 10).all()
    assert (end["contact_time"] > 0.6).all()
    assert not env.base_env._held.any()
    again = env.reset()
    assert env.base_env._held.all()
    assert (again["held_force"] == 0).all()
    assert all(model.geom("plate0").conaffinity[0] == 1 for model in env.base_env.engine.models)


@pytest.mark.parametrize("name", ["blocked", "jammed", "release", "table"])
def test_nothing_touches_a_plate_at_the_start(name):
    env = ObstructedPushEnv(256, obstacle=OBSTACLES[name], goal="pose", seed=5, **THREADS)
    tensordict = env.reset()
    for _ in range(2):
        tensordict = env.step(tensordict.set("action", torch.zeros(256, 7)))["next"]
    assert (tensordict["peak_force"] == 0).all()
    assert (tensordict["held_force"] == 0).all()
    assert not tensordict["diverged"].any()


@pytest.mark.parametrize("name", [name for name in OBSTACLES if name != "table"])
def test_what_a_policy_sees_at_the_start_is_what_it_sees_without_an_obstacle(name):
    there = ObstructedPushEnv(5, obstacle=OBSTACLES[name], goal="pose", seed=11, **THREADS)
    plain = PushEnv(5, goal="pose", seed=11, **THREADS)
    for _ in range(2):  # the second episode too
        seen, expected = there.reset(), plain.reset()
        assert set(seen.keys()) - set(expected.keys()) == ADDED
        for key in set(expected.keys()) - set(PRIVILEGED):
            assert_close(seen[key], expected[key], rtol=0, atol=0, msg=key)


def test_a_table_that_is_too_high_lifts_tool_and_box_and_nothing_that_is_known():
    there = ObstructedPushEnv(3, obstacle=OBSTACLES["table"], seed=1, **THREADS)
    plain = PushEnv(3, seed=1, **THREADS)
    seen, expected = there.reset(), plain.reset()
    for key in ("box_start", "goal", "via_position", "box_size"):
        assert_close(seen[key], expected[key], rtol=0, atol=1e-4)
    assert_close(seen["box_pose"][:, 2], expected["box_pose"][:, 2] + 0.02)
    for _ in range(10):
        seen = there.step(seen.set("action", torch.zeros(3, 7)))["next"]
    assert_close(seen["box_pose"][:, 2], expected["box_pose"][:, 2] + 0.02, rtol=0, atol=1e-3)


def test_the_episode_of_a_row_depends_on_neither_the_batch_nor_earlier_runs():
    def fronts(num_envs):
        env = ObstructedPushEnv(num_envs, obstacle=OBSTACLES["release"], goal="pose", seed=8, **THREADS)
        env.reset()
        env.reset()
        return env._front[:2], env._moment[:2]

    for one, other in zip(fronts(2), fronts(4), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("name", ["hand", "release"])
def test_an_obstructed_environment_fits_its_specs(name):
    check_env_specs(ObstructedPushEnv(2, obstacle=OBSTACLES[name], duration=0.05, seed=0, **THREADS))


def test_the_reference_jumps_once_by_its_distance_towards_the_plate():
    env = ObstructedPushEnv(4, obstacle=OBSTACLES["jump"], seed=2, **THREADS)
    tensordict = env.reset()
    offsets = []
    for _ in range(env.horizon):
        offsets.append(env.reference_offset().clone())
        tensordict = env.step(tensordict.set("action", torch.zeros(4, 7)))["next"]
    size = torch.stack(offsets).norm(dim=-1)
    assert_close(size.unique(), torch.tensor([0.0, 0.1]))
    assert (size.diff(dim=0) >= 0).all()
    assert len({int(column.argmax()) for column in size.T}) == 4, "at a moment of its own in each episode"
    ahead = torch.from_numpy(np.stack([np.cos(env._heading), np.sin(env._heading)], -1)).float()
    assert_close(offsets[-1][:, :2], 0.1 * ahead)
