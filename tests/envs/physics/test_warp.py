"""MuJoCo Warp as an engine, on its CPU device, beside MuJoCo on threads."""

from __future__ import annotations

import copy
import pickle
import sys

import numpy as np
import pytest
import torch
from dm_control import mjcf

from ppt_rl.arms import PANDA
from ppt_rl.envs import EngineConfig, MazeEnv, PushEnv
from ppt_rl.envs.models import remove_looks
from ppt_rl.envs.physics import Parameter, ThreadedPhysics, WarpPhysics, warp_worlds
from ppt_rl.envs.push.scene import push_scene

pytest.importorskip("mujoco_warp", reason="MuJoCo Warp is not installed: pip install 'ppt_rl[gpu]'")

WRITTEN = ("geom_size", "geom_friction", "body_mass", "body_inertia")
CPU = torch.device("cpu")
LIMITS = torch.tensor(PANDA.joints.torque_limits, dtype=torch.float64)


def model():
    root = push_scene(PANDA)
    remove_looks(root)
    return mjcf.Physics.from_mjcf_model(root).model.ptr


def parameters(num_envs):
    """Boxes that differ from world to world."""
    half = torch.linspace(0.03, 0.04, num_envs, dtype=torch.float64).unsqueeze(-1)
    mass = torch.linspace(0.05, 0.5, num_envs, dtype=torch.float64).unsqueeze(-1)
    friction = torch.linspace(0.2, 0.6, num_envs, dtype=torch.float64).reshape(-1, 1, 1)
    inertia = mass * (2 * half).square() / 6
    return [
        Parameter("geom_size", ("box",), half.expand(-1, 3).unsqueeze(1)),
        Parameter("geom_friction", ("box",), friction),
        Parameter("body_mass", ("box",), mass),
        Parameter("body_inertia", ("box",), inertia.expand(-1, 3).unsqueeze(1)),
    ]


def positions(num_envs, scatter=0.0):
    generator = torch.Generator().manual_seed(0)
    arm = torch.tensor(PANDA.home, dtype=torch.float64)
    arm = arm + scatter * torch.randn(num_envs, 7, generator=generator, dtype=torch.float64)
    half = parameters(num_envs)[0].values[:, 0, :1]
    box = torch.tensor([0.45, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], dtype=torch.float64).repeat(num_envs, 1)
    box[:, 2:3] = half
    return torch.cat([arm, box], -1)


def controls(num_envs, steps, share=0.02, seed=0):
    """Random torques within a share of the limits, ``(steps, num_envs, 7)``."""
    unit = torch.rand(steps, num_envs, 7, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return share * (2 * unit - 1) * LIMITS


def begun(engine, scatter=0.0):
    rows = torch.arange(engine.num_envs)
    engine.write(rows, parameters(engine.num_envs))
    return engine.reset(rows, positions(engine.num_envs, scatter))


def warp(num_envs=4, substeps=2, **options):
    engine = WarpPhysics(model(), num_envs, substeps, CPU, written=WRITTEN, **options)
    begun(engine)
    return engine


def states(engine):
    return torch.from_numpy(np.stack([engine.state(row) for row in range(engine.num_envs)]))


def difference(a, b):
    """Largest difference relative to the largest value."""
    return float((a.double() - b.double()).abs().max() / b.double().abs().max())


# -- parity ------------------------------------------------------------------------------------------------------------


def test_a_reset_and_one_substep_agree_with_mujoco_to_a_hundred_thousandth():
    ours = WarpPhysics(model(), 4, 1, CPU, written=WRITTEN)
    theirs = ThreadedPhysics(model(), 4, 1, 1)
    assert difference(begun(ours, 0.2), begun(theirs, 0.2)) < 1e-5
    (control,) = controls(4, 1, share=0.5)
    assert difference(ours.step(control).sensors, theirs.step(control).sensors) < 1e-5
    after, expected = states(ours), states(theirs)
    speeds = slice(1 + 14, None)
    assert difference(after, expected) < 1e-5
    assert difference(after[:, speeds], expected[:, speeds]) < 1e-5


@pytest.mark.parametrize("friction", [0.0, 0.5], ids=["smooth", "rough"])
@pytest.mark.parametrize("damping", [0.0, 20.0], ids=["undamped", "damped"])
def test_joints_with_and_without_damping_and_friction_move_as_mujoco_moves_them(damping, friction):
    joints = model()
    joints.dof_damping[:7], joints.dof_frictionloss[:7] = damping, friction
    ours, theirs = WarpPhysics(joints, 4, 20, CPU, written=WRITTEN), ThreadedPhysics(joints, 4, 20, 1)
    begun(ours, 0.2), begun(theirs, 0.2)
    (control,) = controls(4, 1, share=0.5)
    speeds = slice(7, 14)  # of the joints
    after, expected = (engine.step(control).sensors[:, -1, speeds] for engine in (ours, theirs))
    assert difference(after, expected) < 1e-4


def test_what_follows_from_a_written_parameter_is_that_of_mujoco():
    ours, theirs = warp(), ThreadedPhysics(model(), 4, 1, 1)
    begun(theirs)
    for field in ("geom_size", "geom_rbound", "geom_aabb", "body_mass", "body_invweight0", "dof_invweight0"):
        expected = torch.from_numpy(np.stack([getattr(each, field) for each in theirs.models]))
        found = ours.worlds.field(field)
        torch.testing.assert_close(found.reshape(expected.shape).double(), expected, rtol=1e-5, atol=1e-6)


def test_fifty_control_steps_of_a_push_without_contact_with_the_tool_agree_to_a_thousandth():
    ours, theirs = (PushEnv(2, goal="pose", seed=0, engine=name) for name in ("warp", "threads"))
    ends = []
    for env in (ours, theirs):
        tensordict = env.reset()
        for action in controls(2, 50).float():
            tensordict = env.step(tensordict.set("action", action))["next"]
        ends.append(tensordict)
    for key in ("joint_position", "joint_velocity", "pose", "twist", "box_pose", "via_position", "reward"):
        assert difference(ends[0][key], ends[1][key]) < 1e-3, key


def test_a_tool_pressed_along_a_wall_of_a_maze_feels_the_same_force():
    ends, forces = [], []
    for name in ("warp", "threads"):
        env = MazeEnv.mazes(2, seed=0, engine=name)
        tensordict, action = env.reset(), torch.tensor([3.0, 2.0, *[0.0] * 5]).expand(2, 7)
        felt = []
        for _ in range(16):
            tensordict = env.step(tensordict.set("action", action))["next"]
            felt.append(tensordict["wrench"][:, :3].norm(dim=-1))
        ends.append(tensordict), forces.append(torch.stack(felt))
    assert forces[1].max() > 2
    assert difference(*forces) < 0.02
    assert difference(ends[0]["pose"], ends[1]["pose"]) < 1e-4


def test_the_audit_of_a_push_is_the_same():
    totals = []
    for name in ("warp", "threads"):
        env = PushEnv(2, seed=0, engine=EngineConfig(audit=True, name=name, num_threads=1))
        tensordict = env.reset()
        for action in controls(2, 5, share=0.2).float():
            tensordict = env.step(tensordict.set("action", action))["next"]
        totals.append(tensordict["audit"])
    for name, value in totals[1].items():
        torch.testing.assert_close(totals[0][name], value, rtol=1e-3, atol=1e-6, msg=name)


# -- rows --------------------------------------------------------------------------------------------------------------


def test_a_masked_step_moves_its_worlds_as_a_full_step_does_and_no_other_one():
    full, some = warp(), warp()
    (control,) = controls(4, 1)
    before = states(some)
    expected = full.step(control).sensors.clone()
    mask = torch.tensor([True, False, True, False])
    reached = some.step(control, mask)
    assert torch.equal(reached.sensors[mask], expected[mask])
    assert not reached.diverged.any()
    assert torch.equal(states(some)[mask], states(full)[mask])
    assert torch.equal(states(some)[~mask], before[~mask])
    assert torch.equal(some.step(control, ~mask).sensors[~mask], expected[~mask]), "they go on from where they were"


def test_a_reset_of_some_worlds_leaves_the_others_as_they_are():
    engine = warp()
    for control in controls(4, 3):
        engine.step(control)
    before, rows = states(engine), torch.tensor([2, 0])
    engine.write(rows, parameters(4)[::-1])
    sensors = engine.reset(rows, positions(4)[rows])
    assert sensors.shape == (2, engine.model.nsensordata)
    after = states(engine)
    assert torch.equal(after[[1, 3]], before[[1, 3]])
    torch.testing.assert_close(after[rows, 1:15], positions(4)[rows], rtol=0, atol=1e-6)
    assert not after[rows, 15:].any()


def test_readings_of_every_substep_end_with_those_of_the_last_one():
    every, last = warp(substeps=3, every_substep=True), warp(substeps=3)
    (control,) = controls(4, 1)
    readings = every.step(control).sensors
    assert readings.shape[:2] == (4, 3)
    assert torch.equal(readings[:, -1], last.step(control).sensors[:, 0])
    assert not torch.equal(readings[:, 0], readings[:, -1])


# -- divergence --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_control_that_is_not_finite_ends_its_world_alone(value):
    engine, sound = warp(), warp()
    before, (control, after) = states(engine), controls(4, 2)
    poisoned = control.clone()
    poisoned[2, 3] = value
    assert engine.step(poisoned).diverged.tolist() == [False, False, True, False]
    sound.step(control)
    others = [0, 1, 3]
    assert torch.equal(states(engine)[others], states(sound)[others])
    assert torch.equal(states(engine)[2], before[2]), "it keeps the state it had"
    assert not engine.step(after).diverged.any(), "and can go on from there"


@pytest.mark.parametrize("value", [float("nan"), 1e12, -1e11])
@pytest.mark.parametrize("speed", [3, 11], ids=["joint", "box"])
def test_a_state_that_mujoco_would_not_accept_ends_its_world_alone(value, speed):
    engine = warp()
    engine.worlds.state[2][1, speed] = value
    assert engine.step(controls(4, 1)[0]).diverged.tolist() == [False, True, False, False]


def test_more_contacts_than_there_is_room_for_end_their_world_alone():
    """A box on the table has four contacts; in one world it is pushed into the tool as well."""
    engine = warp(contacts=5)
    assert not engine.step(controls(4, 1)[0]).diverged.any()
    rows = torch.tensor([1])
    position = positions(4)[rows]
    half = float(parameters(4)[0].values[1, 0, 0])
    pressed = torch.tensor([[0.45, 0.0, 2 * half + 0.002, 0.0, 1.0, 0.0, 0.0]], dtype=torch.float64)
    position[0, :7] = PushEnv(1, seed=0)._arm_position(pressed)[0]  # the tool reaches 3 mm into the top of the box
    engine.reset(rows, position)
    diverged = [engine.step(torch.zeros(4, 7)).diverged.tolist() for _ in range(3)]
    assert [False, True, False, False] in diverged
    assert not any(step[row] for step in diverged for row in (0, 2, 3))


# -- life --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("clone", [copy.deepcopy, lambda engine: pickle.loads(pickle.dumps(engine))])
def test_a_copy_continues_like_the_original_and_is_one_of_its_own(clone):
    engine = warp()
    first, second = controls(4, 2)
    engine.step(first)
    twin = clone(engine)
    assert torch.equal(states(twin), states(engine))
    expected = engine.step(second).sensors.clone()
    torch.testing.assert_close(twin.step(second).sensors, expected, rtol=1e-5, atol=1e-6)
    twin.worlds.field("body_mass").zero_()
    assert engine.worlds.field("body_mass").any()


def test_a_closed_engine_says_so_and_so_does_its_copy():
    engine = warp()
    engine.close()
    for closed in (engine, copy.deepcopy(engine)):
        with pytest.raises(RuntimeError, match="the physics engine is closed"):
            closed.step(torch.zeros(4, 7))


def test_a_field_that_was_not_announced_is_refused():
    with pytest.raises(ValueError, match="geom_pos is not among the fields that differ between worlds"):
        warp().write(torch.tensor([0]), [Parameter("geom_pos", ("box",), torch.zeros(4, 1, 3))])


def test_without_mujoco_warp_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco_warp", None)
    warp_worlds.import_warp.cache_clear()
    with pytest.raises(ImportError, match=r"pip install 'ppt_rl\[gpu\]'"):
        PushEnv(1, engine="warp")
    warp_worlds.import_warp.cache_clear()


def test_an_environment_is_rendered_from_the_state_of_its_world():
    env = PushEnv(2, seed=0, engine="warp")
    env.reset()
    plain = PushEnv(2, seed=0, engine="threads")
    plain.reset()
    shown, expected = (each.physics(1).data.qpos.copy() for each in (env, plain))
    np.testing.assert_allclose(shown, expected, atol=1e-6)


@pytest.mark.parametrize("name", ["warp", "threads"])
def test_an_engine_is_chosen_by_name(name):
    env = PushEnv(1, seed=0, engine=name)
    assert isinstance(env.engine, WarpPhysics if name == "warp" else ThreadedPhysics)


def test_an_unknown_engine_is_refused():
    with pytest.raises(ValueError, match=r"engine is 'gpu'; expected one of \['auto', 'threads', 'warp'\]"):
        PushEnv(1, engine="gpu")
