"""The audit of pushing episodes."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from ppt_rl.arms import PANDA
from ppt_rl.envs import PandaPushEnv
from ppt_rl.envs.audit import AUDITED
from ppt_rl.envs.readings import sensor_span
from tests.engines import COARSE, engine_of, model_of, write_state
from tests.envs.scenes import act, leaves, rollout, torques

F64 = torch.float64


def push(audit=True, **changes):
    """Two short pushing episodes."""
    settings = {"num_envs": 2, "duration": 0.2, "seed": 0, "engine": replace(COARSE, audit=audit)}
    return PandaPushEnv(**{**settings, **changes})


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_an_audited_environment_fits_its_specs(dtype):
    check_env_specs(push(dtype=dtype))


def test_the_audit_changes_nothing_else_in_a_rollout():
    env = push()
    actions = torques(env, 25, scale=0.1)  # into the second episode
    audited, plain = leaves(rollout(env, actions)), leaves(rollout(push(audit=False), actions))
    added = {f"{nest}audit/{name}" for nest in ("", "next/") for name in AUDITED}
    assert audited.keys() - plain.keys() == added
    assert plain.keys() < audited.keys()
    for name, value in plain.items():
        assert torch.equal(value, audited[name]), name


def test_the_totals_grow_within_an_episode_and_restart_with_the_next():
    env = push()
    run = rollout(env, torques(env, 45, scale=0.1))
    for name in AUDITED:
        value = run["next", "audit", name].squeeze(-1)
        first, second = value[:, :20], value[:, 20:40]
        assert (value > 0).all(), name
        for episode in (first, second):
            assert (episode.diff(dim=1) >= 0).all(), name
            assert (episode[:, -1] > episode[:, 0]).all(), name
        assert (run["audit", name][:, [0, 20, 40]] == 0).all(), name
        assert (second[:, 0] < first[:, -1]).all(), name


def test_a_partial_reset_clears_its_environments_only_and_a_masked_environment_adds_nothing():
    env = push(num_envs=3)
    torque = torques(env, 4, scale=0.1)
    observation = act(env, env.reset(), torque[:, 0])
    reset = env.reset(observation.copy().set("_reset", torch.tensor([[True], [False], [False]])))
    mask = torch.tensor([False, True, False])
    after = act(env, reset.copy().set("_step", mask), torque[:, 1])
    for name in AUDITED:
        old, opened, new = (each["audit", name].squeeze(-1) for each in (observation, reset, after))
        assert (old > 0).all(), name
        assert opened[0] == 0, name
        assert torch.equal(opened[1:], old[1:]), name
        assert torch.equal(new[~mask], opened[~mask]), name
    work = "audit", "commanded_work"
    assert after[work][1] > reset[work][1]


def test_an_environment_whose_physics_diverges_keeps_its_totals():
    env = push()
    torque = torques(env, 2, scale=0.1)
    before = act(env, env.reset(), torque[:, 0])
    write_state(env, 1, 3, np.nan)
    after = act(env, before, torque[:, 1])
    assert after["diverged"].squeeze(-1).tolist() == [False, True]
    for name in AUDITED:
        assert torch.equal(after["audit", name][1], before["audit", name][1]), name
    assert after["audit", "commanded_work"][0] > before["audit", "commanded_work"][0]


def test_the_commanded_work_is_that_of_the_engines_torques_over_every_substep(monkeypatch):
    env = push(dtype=F64)
    inner, work, peak = engine_of(env), torch.zeros(2, dtype=F64), torch.zeros(2, dtype=F64)
    velocity = sensor_span(model_of(env, 0), "joint_velocity1", "joint_velocity7")
    step = inner.step

    def spy(control, rows=None):
        result = step(control, rows)
        assert result.sensors.shape[:2] == (2, 5)
        power = np.einsum("rj,rkj->rk", control, result.sensors[..., velocity])
        work.add_(torch.from_numpy(np.abs(power).sum(-1) * 0.002))
        peak.copy_(torch.maximum(peak, torch.from_numpy(np.abs(power).max(-1))))
        return result

    monkeypatch.setattr(inner, "step", spy)
    run = rollout(env, torques(env, 15, scale=0.1))["next", "audit"]
    assert_close(run["commanded_work"][:, -1, 0], work)
    assert_close(run["commanded_power"][:, -1, 0], peak)


def test_at_the_rate_of_the_physics_the_audit_sums_what_is_observed():
    env = push(control_dt=0.002, duration=0.1, dtype=F64)
    action = torques(env, 40, scale=1.3)  # some of them above the limits
    limit = torch.tensor(PANDA.joints.torque_limits, dtype=F64)
    assert (action.abs() > limit).any()
    run = rollout(env, action)
    after = run["next"]
    # An observation after a step was read at the beginning of its only substep, when the torque already acted.
    commanded = (action.clamp(-limit, limit) * after["joint_velocity"]).sum(-1, keepdim=True).abs()
    measured = (after["wrench"] * after["twist"]).sum(-1, keepdim=True).abs()
    for name, power in (("commanded", commanded), ("measured", measured)):
        assert_close(after["audit", f"{name}_work"], 0.002 * power.cumsum(1))
        assert_close(after["audit", f"{name}_power"], power.cummax(1).values)
    early = (action.clamp(-limit, limit) * run["joint_velocity"]).sum(-1).abs().sum(1) * 0.002
    assert (early / after["audit", "commanded_work"][:, -1, 0] - 1).abs().max() > 0.01  # a shift by one substep shows
