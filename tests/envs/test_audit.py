import math

import numpy as np
import pytest
import torch
from dm_control import mjcf
from torch.testing import assert_close

from ppt_rl.arms import PANDA
from ppt_rl.envs.audit import AUDITED, AuditedPhysics
from ppt_rl.envs.models import PADDLE, table_scene
from ppt_rl.envs.physics import PhysicsStep
from ppt_rl.envs.readings import sensor_span

F64 = torch.float64
H = 0.001  # physics step of the scripted engine [s]


@pytest.fixture(scope="module")
def model():
    """The arm without gravity, so that the wrist sensor measures the wrench on the world and no weight."""
    model = mjcf.Physics.from_mjcf_model(table_scene(PANDA, PADDLE, physics_dt=H)).model.ptr
    model.opt.gravity[:] = 0.0
    return model


class ScriptedEngine:
    """Replays joint velocities and tool speeds, with a constant force of 1 N on the world.

    Args:
        model: the model whose sensors it fills.
        velocity: ``(num_envs, steps, substeps)`` velocity of the second joint [rad/s].
        speed: speed of the tool along y, of the same shape [m/s].
    """

    def __init__(self, model, velocity, speed=None):
        self.num_envs, self.device = len(velocity), torch.device("cpu")
        self.model, self.velocity = model, velocity
        self.speed = np.zeros_like(velocity) if speed is None else speed
        self.clock = np.zeros(self.num_envs, dtype=int)
        self.diverging = np.zeros(self.num_envs, dtype=bool)

    def reset(self, rows, position):
        return torch.zeros(len(rows), self.model.nsensordata, dtype=F64)

    def step(self, control, mask=None):
        now, rows = self.clock.copy(), np.arange(self.num_envs)
        self.clock += 1 if mask is None else mask.numpy()
        sensors = np.zeros((self.num_envs, self.velocity.shape[-1], self.model.nsensordata))
        sensors[..., sensor_span(self.model, "joint_velocity2", "joint_velocity2")] = self.velocity[rows, now, :, None]
        sensors[..., sensor_span(self.model, "linear_velocity", "linear_velocity").start + 1] = self.speed[rows, now]
        sensors[..., sensor_span(self.model, "force", "force").start + 1] = 1.0
        sensors[..., sensor_span(self.model, "orientation", "orientation").start] = 1.0
        sensors[self.diverging] = np.nan
        return PhysicsStep(torch.from_numpy(sensors), torch.from_numpy(self.diverging.copy()))


def torque(*values):
    """``(R, 7)`` torques: these on the second joint, and 5 N m on the first, which does not move."""
    control = torch.zeros(len(values), 7, dtype=F64)
    control[:, 0], control[:, 1] = 5.0, torch.tensor(values, dtype=F64)
    return control


def totals(audited):
    """The audited totals by name, ``(num_envs,)`` each."""
    return {name: value.squeeze(-1) for name, value in audited.observe(F64).items()}


def test_all_totals_are_zero_before_the_first_step(model):
    audited = AuditedPhysics(ScriptedEngine(model, np.ones((2, 1, 10))), model)
    assert tuple(audited.observe(torch.float32)) == AUDITED
    assert all(value.dtype == torch.float32 for value in audited.observe(torch.float32).values())
    assert all(torch.equal(value, torch.zeros(2, 1, dtype=F64)) for value in audited.observe(F64).values())


def test_a_constant_power_does_work_in_proportion_to_time(model):
    engine = ScriptedEngine(model, np.full((2, 4, 10), 0.5), np.full((2, 4, 10), 0.3))
    audited = AuditedPhysics(engine, model)
    for step in range(1, 5):
        audited.step(torque(2.0, 6.0))
        seconds = step * 10 * H
        found = totals(audited)
        assert_close(found["commanded_work"], torch.tensor([1.0, 3.0], dtype=F64) * seconds)
        assert_close(found["commanded_power"], torch.tensor([1.0, 3.0], dtype=F64))
        assert_close(found["measured_work"], torch.tensor([0.3, 0.3], dtype=F64) * seconds)
        assert_close(found["measured_power"], torch.tensor([0.3, 0.3], dtype=F64))


def test_braking_counts_like_pushing_so_a_sinusoidal_power_does_the_work_of_its_absolute_value(model):
    phase = 2 * math.pi * np.arange(1000).reshape(1, 20, 50) / 1000  # one period in a second, 20 control steps
    audited = AuditedPhysics(ScriptedEngine(model, 0.5 * np.sin(phase), 0.3 * np.cos(phase)), model)
    for _ in range(20):
        audited.step(torque(4.0))
    found = totals(audited)
    assert found["commanded_work"].item() == pytest.approx(2.0 * 2 / math.pi, rel=1e-5)
    assert found["commanded_power"].item() == pytest.approx(2.0)
    assert found["measured_work"].item() == pytest.approx(0.3 * 2 / math.pi, rel=1e-5)
    assert found["measured_power"].item() == pytest.approx(0.3)


def test_the_largest_power_is_remembered_after_it_has_passed(model):
    velocity = np.zeros((1, 3, 4))
    velocity[0, 1, 2] = -3.0  # one substep of the second control step, braking
    audited = AuditedPhysics(ScriptedEngine(model, velocity), model)
    peaks = []
    for _ in range(3):
        audited.step(torque(2.0))
        peaks.append(totals(audited)["commanded_power"].item())
    assert peaks == [0.0, 6.0, 6.0]
    assert totals(audited)["commanded_work"].item() == pytest.approx(6.0 * H)


def test_a_diverged_environment_adds_nothing_and_goes_on_afterwards(model):
    engine = ScriptedEngine(model, np.ones((3, 3, 10)), np.ones((3, 3, 10)))
    audited = AuditedPhysics(engine, model)
    audited.step(torque(1.0, 1.0, 1.0))
    engine.diverging[1] = True
    audited.step(torque(2.0, 2.0, 2.0))
    found = totals(audited)
    assert_close(found["commanded_work"], torch.tensor([3.0, 1.0, 3.0], dtype=F64) * 10 * H)
    assert_close(found["commanded_power"], torch.tensor([2.0, 1.0, 2.0], dtype=F64))
    assert_close(found["measured_work"], torch.tensor([2.0, 1.0, 2.0], dtype=F64) * 10 * H)
    engine.diverging[1] = False
    audited.step(torque(4.0, 4.0, 4.0))
    assert_close(totals(audited)["commanded_work"], torch.tensor([7.0, 5.0, 7.0], dtype=F64) * 10 * H)


def test_a_reset_clears_the_totals_of_its_environments_only(model):
    audited = AuditedPhysics(ScriptedEngine(model, np.ones((4, 2, 10)), np.ones((4, 2, 10))), model)
    audited.step(torque(1.0, 2.0, 3.0, 4.0))
    audited.reset(torch.tensor([2, 0]), torch.zeros(2, 7))
    found = totals(audited)
    assert_close(found["commanded_power"], torch.tensor([0.0, 2.0, 0.0, 4.0], dtype=F64))
    assert_close(found["commanded_work"], torch.tensor([0.0, 2.0, 0.0, 4.0], dtype=F64) * 10 * H)
    assert_close(found["measured_work"], torch.tensor([0.0, 1.0, 0.0, 1.0], dtype=F64) * 10 * H)
    assert_close(found["measured_power"], torch.tensor([0.0, 1.0, 0.0, 1.0], dtype=F64))


def test_a_step_of_some_environments_adds_to_their_totals_only(model):
    audited = AuditedPhysics(ScriptedEngine(model, np.ones((4, 2, 10))), model)
    audited.step(torque(1.0, 1.0, 1.0, 1.0))
    audited.step(torque(9.0, 2.0, 9.0, 3.0), torch.tensor([False, True, False, True]))
    found = totals(audited)
    assert_close(found["commanded_work"], torch.tensor([1.0, 3.0, 1.0, 4.0], dtype=F64) * 10 * H)
    assert_close(found["commanded_power"], torch.tensor([1.0, 2.0, 1.0, 3.0], dtype=F64))


def test_what_was_observed_does_not_change_with_the_next_step(model):
    audited = AuditedPhysics(ScriptedEngine(model, np.ones((1, 2, 10))), model)
    audited.step(torque(1.0))
    kept = audited.observe(F64)
    copy = {name: value.clone() for name, value in kept.items()}
    audited.step(torque(1.0))
    assert all(torch.equal(kept[name], copy[name]) for name in AUDITED)
