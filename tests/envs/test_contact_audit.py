"""The contact audit on an engine that plays back prescribed forces."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from ppt_rl.envs.contact_audit import CONTACT, ContactAudit
from ppt_rl.envs.physics import PhysicsStep

DT, SUBSTEPS = 0.0005, 20
SENSORS = {"linear_velocity": (0, 3), "first": (3, 3), "second": (6, 3)}
WEIGHT = np.asarray([0.0, 0.0, -0.5])


class Model:
    """Where the sensors lie, as a compiled model says it."""

    opt = SimpleNamespace(timestep=DT)

    @staticmethod
    def sensor(name):
        begin, size = SENSORS[name]
        return SimpleNamespace(adr=[begin], dim=[size])


class Playback:
    """An engine whose readings are prescribed: ``forces`` and ``speed`` ``(B, T)`` at every substep."""

    def __init__(self, forces, speed, diverged=None):
        self.num_envs, self.now, self.device = len(forces), 0, torch.device("cpu")
        self.readings = np.zeros((*forces.shape, 9))
        self.readings[..., 0] = speed
        self.readings[..., 3:6] = WEIGHT
        self.readings[..., 6:9] = WEIGHT + forces[..., None] * [0.6, 0.0, -0.8]
        self.diverged = np.zeros(len(forces), bool) if diverged is None else np.asarray(diverged)

    def reset(self, rows, position):
        self.now = 0
        return torch.from_numpy(np.tile(np.r_[0.0, 0.0, 0.0, WEIGHT, WEIGHT], (len(rows), 1)))

    def step(self, control, mask=None):
        chunk = self.readings[:, self.now : self.now + SUBSTEPS]
        self.now += SUBSTEPS
        return PhysicsStep(torch.from_numpy(chunk), torch.from_numpy(self.diverged))


def audited(forces, speed=0.3, **kwargs):
    """The measurements of both sensors after all substeps of ``forces`` ``(B, T)``."""
    engine = Playback(np.asarray(forces, float), speed, **kwargs)
    audit = ContactAudit(engine, Model(), ["first", "second"], horizon=forces.shape[1] * DT)
    audit.reset(torch.arange(engine.num_envs), torch.zeros(engine.num_envs, 1))
    for _ in range(forces.shape[1] // SUBSTEPS):
        audit.step(torch.zeros(engine.num_envs, 1))
    return audit


def of(audit, name, sensor=1):
    return audit.measured[:, sensor, CONTACT.index(name)]


def test_forces_are_those_of_their_definitions_whatever_they_are():
    rng = np.random.default_rng(0)
    steps = 4000  # 2 s
    forces = rng.uniform(1.0, 50.0, (3, steps))
    forces[0, :1234] = 0.0  # contact after 0.617 s
    forces[1, :] = 0.0
    forces[2, 3000] = 400.0  # late: after the first half second of contact
    audit = audited(forces)
    np.testing.assert_allclose(of(audit, "peak_force"), forces.max(1), rtol=1e-12)
    np.testing.assert_allclose(of(audit, "static_force"), forces[:, -400:].mean(1), rtol=1e-12)
    windows = [forces[0, 1234:2235].max(), 0.0, forces[2, :1001].max()]
    np.testing.assert_allclose(of(audit, "pressure_force"), windows, rtol=1e-12)
    np.testing.assert_allclose(of(audit, "contact_time"), [0.617, np.nan, 0.0], atol=1e-12)
    np.testing.assert_allclose(of(audit, "contact_speed"), [0.3, 0.0, 0.3])


def test_the_reading_at_the_reset_is_no_force():
    audit = audited(np.full((2, 400), 7.0))
    assert (of(audit, "peak_force", sensor=0) == 0).all()
    assert np.isnan(of(audit, "contact_time", sensor=0)).all()
    np.testing.assert_allclose(of(audit, "static_force"), 7.0)


def test_a_diverged_environment_is_not_measured():
    audit = audited(np.full((2, 400), 7.0), diverged=[True, False])
    np.testing.assert_allclose(of(audit, "peak_force"), [0.0, 7.0])


def test_only_environments_that_step_are_measured_and_a_reset_starts_again():
    engine = Playback(np.full((3, 400), 9.0), 0.1)
    audit = ContactAudit(engine, Model(), ["second"], horizon=0.2)
    audit.reset(torch.arange(3), torch.zeros(3, 1))
    audit.step(torch.zeros(3, 1), torch.tensor([True, False, True]))
    assert of(audit, "peak_force", 0).tolist() == pytest.approx([9.0, 0.0, 9.0])
    audit.reset(torch.tensor([0]), torch.zeros(1, 1))
    assert of(audit, "peak_force", 0).tolist() == pytest.approx([0.0, 0.0, 9.0])
    assert np.isnan(of(audit, "contact_time", 0)[:2]).all()
