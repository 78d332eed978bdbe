from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torchrl.envs import Compose, TransformedEnv

from ppt_rl.arms import PANDA
from ppt_rl.envs import PandaPushEnv
from ppt_rl.functional import kinetic_energy, orientation_error, spring_energy
from ppt_rl.functional.stability import largest_damping_factor
from ppt_rl.modules import CartesianImpedanceController, Kinematics
from ppt_rl.transforms import (
    EnergyAwareImpedanceTransform,
    ImpedanceTransform,
    JointTorqueTransform,
    MacroStepTransform,
    ReferenceGovernorTransform,
)
from tests.engines import COARSE
from tests.sampling import normal
from tests.transforms.cases import push_env
from tests.transforms.mocks import MockArmEnv, ScriptedEnv, play

LAWS = settings(max_examples=15, deadline=None, derandomize=True)
START = torch.tensor((0.4, -0.1, 0.2, 0.0, 1.0, 0.0, 0.0))


def run(seed, make, fast=0.5):
    """Steps of a tool that follows a script, under random references; ``executed`` is the wrench."""
    pose, twist = START + 0.1 * normal(9, 7, seed=seed).float(), fast * normal(9, 6, seed=seed + 1).float()
    pose[:, 3:] /= pose[:, 3:].norm(dim=-1, keepdim=True)
    env = TransformedEnv(ScriptedEnv(6, pose=pose[None], twist=twist[None]), make())
    references = torch.cat([pose[:8], twist[:8]], -1) + 0.2 * normal(8, 13, seed=seed + 2).float()
    references[:, 3:7] /= references[:, 3:7].norm(dim=-1, keepdim=True)
    return play(env, references.unsqueeze(1))[0]


def aware(**kwargs):
    return EnergyAwareImpedanceTransform(CartesianImpedanceController(), **{"dt": 0.01, **kwargs})


@LAWS
@given(seed=st.integers(0, 10**6), e_max=st.floats(0.05, 5.0), p_max=st.floats(0.1, 10.0))
def test_energy_and_power_of_the_executed_wrench_are_within_their_limits_at_every_step(seed, e_max, p_max):
    controller = CartesianImpedanceController()
    steps = run(seed, lambda: aware(e_max=e_max, p_max=p_max))
    power = (steps["next", "executed"] * steps["twist"]).sum(-1)
    assert (power <= p_max + 1e-4 * (1 + power.abs())).all()
    reference = steps["action"]
    turn = orientation_error(steps["pose"][:, 3:], reference[:, 3:7])
    error = torch.cat([reference[:, :3] - steps["pose"][:, :3], turn], -1)
    factor = steps["next", "stiffness_factor"]
    left = (e_max - kinetic_energy(steps["twist"], controller.inertia)).clamp_min(0.0)
    assert (factor * spring_energy(error, controller.stiffness) <= left + 1e-5 * e_max).all()


def test_with_wide_limits_the_wrench_is_that_of_the_plain_impedance_bit_by_bit():
    wide = run(3, lambda: aware(e_max=1e6, p_max=1e6))
    plain = run(3, lambda: ImpedanceTransform(CartesianImpedanceController()))
    assert torch.equal(wide["next", "executed"], plain["next", "executed"])
    assert (wide["next", "stiffness_factor"] == 1).all()
    assert (wide["next", "damping_factor"] == 1).all()


def test_a_resting_tool_is_pressed_with_no_more_than_the_force_of_the_budget_however_far_the_reference():
    transform = aware(e_max=0.5)
    td = MockArmEnv((3,), action_shape=(6,)).reset()
    td["twist"].zero_()
    reference = torch.cat([td["pose"], torch.zeros(3, 6)], -1)
    reference[:, 0] += torch.tensor((0.04, 0.05, 0.5))
    force = transform.inv(td.set("action", reference))["action"][:, 0]
    bound = math.sqrt(2 * 400 * 0.5)
    assert force.tolist() == pytest.approx([16.0, bound, bound / 10], rel=1e-4)


def test_a_governor_finds_its_controller():
    transform = aware(dt=None)
    env = TransformedEnv(MockArmEnv((2,), action_shape=(6,)), Compose(transform, ReferenceGovernorTransform()))
    env.reset()
    assert env.transform[-1]._controller() is transform.controller


def test_a_place_after_a_macro_step_is_refused():
    chain = Compose(MacroStepTransform(5), aware(dt=None))
    with pytest.raises(ValueError, match="stands after a MacroStepTransform"):
        TransformedEnv(MockArmEnv((2,), action_shape=(6,)), chain).reset()


def test_on_the_arm_the_strongest_damping_slows_the_tool_down_without_turning_it_around():
    env = push_env(
        1, JointTorqueTransform(Kinematics(PANDA, PandaPushEnv.tool.length)),
        EnergyAwareImpedanceTransform(CartesianImpedanceController(), 100.0, 0.1), duration=0.6, engine=COARSE,
    )  # fmt: skip
    td = env.reset()
    reference = torch.cat([td["pose"], torch.zeros(1, 6)], -1)
    speeds, factors = [], []
    for number in range(50):
        if number in (0, 10):
            reference[:, 2] += 0.2  # the second time while the tool is moving
        td = env.step(td.set("action", reference))["next"]
        speeds.append(td["twist"][0, 2].item())
        factors.append(td["damping_factor"].item())
    controller = CartesianImpedanceController()
    most = largest_damping_factor(controller.damping, controller.inertia, 0.01).item()
    assert max(factors) == pytest.approx(most)
    assert min(speeds[1:]) > 0.0
    assert td["pose"][0, 2] > reference[0, 2] - 0.39
