"""The tank's accounting compared with the audit.

The tank charges |wrench . twist| dt at control rate, for the twist that it observes. The audit integrates |tau . qdot|
over every substep of the physics, from sensors that no transform touches. The two differ for two reasons: the twist
changes while the wrench is held, and the posture torque, which is not part of the wrench, damps the elbow.
"""

from dataclasses import replace
from functools import partial

import pytest
import torch
from tensordict import TensorDictBase

from ppt_rl.recipes import ppo_ppt_push as recipe
from ppt_rl.tasks import motor_tank
from ppt_rl.tasks.push import fit_push_prior, make_push_env
from ppt_rl.transforms import EnergyTankTransform, JointTorqueTransform

#: The paper's task, with a reference that takes some power.
POSITION = recipe.Config(goal="position", num_basis=8, num_threads=1)
ULP = torch.finfo(torch.float32).eps


@pytest.fixture(scope="module")
def promp():
    return fit_push_prior(recipe.make_modules(POSITION)["promp"])


def pushed(promp, *, steps=0, tank=None, posture=True, **changes) -> tuple[recipe.Config, TensorDictBase]:
    """Eight audited episodes of PPT's own chain without a residual, or their first ``steps`` control steps."""
    config = replace(POSITION, physics_dt=0.001, replan_steps=steps, **changes)
    with pytest.MonkeyPatch.context() as patch:
        # The accounting is that of the paper's tank; the one at the motors would stop what a wrong one lets through.
        patch.setattr(recipe, "motor_tank", lambda p_max, e_max, *law: motor_tank(1e6, 1e6))
        if tank is not None:
            patch.setattr(recipe, "EnergyTankTransform", tank)
        if not posture:
            without = partial(JointTorqueTransform, posture_stiffness=0.0, posture_damping=0.0)
            patch.setattr(recipe, "JointTorqueTransform", without)
        base = make_push_env(config, num_envs=8, seed=0, audit=True)
        env = recipe.RECIPE.on(base, config, {"promp": promp})
    root = env.reset()
    assert (root["tank_energy"] == config.e_max).all()
    after = env.step(root.set("action", env.action_spec.zero()))["next"]
    assert not after["diverged"].any()
    env.close()
    return config, after


def compare(config: recipe.Config, after: TensorDictBase, tolerance: float) -> None:
    """Assert that the energy taken from the tank is the audited work, within a share of it.

    It is read from the level alone, so nothing else that a tank writes can hide an error. Differences of opposite sign
    in two episodes do not cancel.
    """
    charged = config.e_max - after["tank_energy"].double()  # [J]
    audited = after["audit", "commanded_work"].double()
    gap = float((audited - charged).abs().sum() / charged.sum())
    assert gap < tolerance, f"the tank and the audit differ by {gap:.2%} of what the tank charged"


def test_the_tank_charges_the_work_of_the_metrics_and_agrees_with_the_audit_up_to_the_posture(promp):
    config, after = pushed(promp)
    assert after["done"].all()
    charged, work = config.e_max - after["tank_energy"], after["metrics", "work"]
    # Each of the 300 steps rounds the level down by four units in the last place, the sums by half a unit.
    assert (charged >= work).all()
    assert (charged - work <= 300 * 5 * ULP * config.e_max).all()
    assert (charged > 0.3).all()
    # Measured: 3.4 % for these episodes, 3.3 and 3.6 % for two sets of 64, at most 5.8 % for one of them. Without the
    # posture torque it is 0.1 %, so the gap is the work of that torque.
    compare(config, after, 0.06)


def test_without_the_posture_torque_the_tank_agrees_with_the_audit_within_half_a_percent(promp):
    config, after = pushed(promp, posture=False)
    assert after["done"].all()
    assert (config.e_max - after["tank_energy"] > 0.3).all()
    compare(config, after, 0.005)  # measured: 0.1 %, and at most 0.21 % for one of 128 episodes


def test_at_half_the_control_rate_the_tank_agrees_with_the_audit_as_well(promp):
    # With less damping than usual: the critically damped arm chatters at 50 Hz.
    config, after = pushed(promp, posture=False, control_dt=0.02, damping_ratio=0.5)
    assert after["done"].all()
    assert (after["control_steps"] == 150).all()
    compare(config, after, 0.01)  # measured: 0.3 %


#: The first second of an episode; the valve acts in half of the environments, without which two of the wrong tanks
#: below would be right.
SECOND = {"steps": 100, "posture": False, "p_max": 0.5}
TOLERANCE = 0.02  # measured: 0.5 %, and 0.6 and 0.7 % for two sets of 64


def test_the_tank_agrees_with_the_audit_while_the_valve_throttles(promp):
    config, after = pushed(promp, **SECOND)
    assert (after["control_steps"] == 100).all()
    compare(config, after, TOLERANCE)


class ShortStepTank(EnergyTankTransform):
    """It works with a tenth of the control step."""

    dt = EnergyTankTransform.dt.getter(lambda self: 0.1 * EnergyTankTransform.dt.fget(self))


class BlindTank(EnergyTankTransform):
    """Its flow is zero."""

    def _flow(self, tensordict, effort):
        return torch.zeros_like(effort)


class LateTank(EnergyTankTransform):
    """Its flow is five control steps old."""

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self.seen = []

    def _flow(self, tensordict, effort):
        self.seen.append(super()._flow(tensordict, effort))
        return self.seen[max(0, len(self.seen) - 6)]


class OneAxisBlindTank(EnergyTankTransform):
    """It does not see the tool move along x."""

    def _flow(self, tensordict, effort):
        return super()._flow(tensordict, effort) * torch.tensor([0.0, 1.0, 1.0, 1.0, 1.0, 1.0])


class LouderAfterTank(EnergyTankTransform):
    """The wrench is doubled after it, as by a gain that follows the tank."""

    def _inv_call(self, tensordict):
        tensordict = super()._inv_call(tensordict)
        return tensordict.set("action", 2 * tensordict["action"])


class BypassedTank(EnergyTankTransform):
    """It charges as if its valve acted, but the wrench bypasses it."""

    def _inv_call(self, tensordict):
        wrench = tensordict["action"]
        return super()._inv_call(tensordict).set("action", wrench)


class NominalTank(EnergyTankTransform):
    """It charges the nominal power, not the power that its valve lets through."""

    def _inv_call(self, tensordict):
        effort, level = tensordict["action"], tensordict["tank_energy"]
        power = (effort * self._flow(tensordict, effort)).sum(-1, keepdim=True).abs()
        tensordict = super()._inv_call(tensordict)
        self._stash(tensordict, "tank_energy", (level - power * self.dt).clamp(0.0, self.e_max))
        return tensordict


class FreeBrakesTank(EnergyTankTransform):
    """It charges pushing only; the audit, like the paper, counts braking as well."""

    def _inv_call(self, tensordict):
        effort, level = tensordict["action"], tensordict["tank_energy"]
        brakes = (effort * self._flow(tensordict, effort)).sum(-1, keepdim=True) < 0
        tensordict = super()._inv_call(tensordict)
        self._stash(tensordict, "tank_energy", torch.where(brakes, level, tensordict["_tank_energy"]))
        return tensordict


class RefilledTank(EnergyTankTransform):
    """It gains a millijoule from nowhere in every control step."""

    def _level(self, tensordict, effort):
        return (super()._level(tensordict, effort) + 0.001).clamp_max(self.e_max)


# A flow of the wrong sign is not among them: the tank takes the absolute power, so such a tank is right. Nor is a flow
# that is one control step old: it changes the energy by 1.6 %, which is within the tolerance.
@pytest.mark.parametrize(
    "tank",
    [
        ShortStepTank, BlindTank, LateTank, OneAxisBlindTank, LouderAfterTank, BypassedTank, NominalTank,
        FreeBrakesTank, RefilledTank,
    ],
)  # fmt: skip
def test_a_wrong_tank_is_caught_by_the_same_check(promp, tank):
    config, after = pushed(promp, tank=tank, **SECOND)
    with pytest.raises(AssertionError, match="the tank and the audit differ by"):
        compare(config, after, TOLERANCE)
