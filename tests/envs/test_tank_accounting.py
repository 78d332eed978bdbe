"""The books of the tank against the audit.

The tank books |wrench . twist| dt at control rate, from the twist that it saw. The audit integrates |tau . qdot| over
every substep of the physics, from sensors that no transform touches. What the two may differ by: the twist changes
while the wrench is held, and the posture torque, which the wrench does not know of, damps the elbow.
"""

from functools import partial

import ppo_ppt_push as recipe
import pytest
import torch
from tensordict import TensorDictBase

from ppt_rl.tasks.push import fit_push_prior
from ppt_rl.transforms import EnergyTankTransform, JointTorqueTransform

ULP = torch.finfo(torch.float32).eps


@pytest.fixture(scope="module")
def promp():
    return fit_push_prior(recipe.make_modules(recipe.Config())["promp"])


def pushed(promp, *, steps=0, tank=None, posture=True, **changes) -> tuple[recipe.Config, TensorDictBase]:
    """Eight audited episodes of PPT's own chain without a residual, or their first ``steps`` control steps."""
    config = recipe.Config(num_threads=1, duration=3.0, physics_dt=0.001, replan_steps=steps, **changes)
    with pytest.MonkeyPatch.context() as patch:
        if tank is not None:
            patch.setattr(recipe, "EnergyTankTransform", tank)
        if not posture:
            without = partial(JointTorqueTransform, posture_stiffness=0.0, posture_damping=0.0)
            patch.setattr(recipe, "JointTorqueTransform", without)
        env = recipe.make_env(config, promp, num_envs=8, seed=0, audit=True)
    root = env.reset()
    assert (root["tank_energy"] == config.e_max).all()
    after = env.step(root.set("action", env.action_spec.zero()))["next"]
    assert not after["diverged"].any()
    env.close()
    return config, after


def check_books(config: recipe.Config, after: TensorDictBase, tolerance: float) -> None:
    """The energy that left the tank is the work that the audit saw, but for a share of it.

    The books are taken from the level alone: whatever a tank says elsewhere, it cannot hide. Differences of different
    episodes do not cancel.
    """
    booked = config.e_max - after["tank_energy"].double()  # [J]
    audited = after["audit", "commanded_work"].double()
    gap = float((audited - booked).abs().sum() / booked.sum())
    assert gap < tolerance, f"books are off by {gap:.2%} of what they say"


def test_the_books_of_the_tank_are_its_own_and_agree_with_the_audit_up_to_the_posture(promp):
    config, after = pushed(promp)
    assert after["done"].all()
    booked, work = config.e_max - after["tank_energy"], after["metrics", "work"]
    # Each of the 300 steps rounds the level down by four units in the last place, the sums by half a unit.
    assert (booked >= work).all()
    assert (booked - work <= 300 * 5 * ULP * config.e_max).all()
    assert (booked > 0.3).all()
    # Measured: 3.4 % for these episodes, 3.3 and 3.6 % for two sets of 64, at most 5.8 % for one of them. Without the
    # posture torque it is 0.1 %, so that torque is what the gap is made of.
    check_books(config, after, 0.06)


def test_without_the_posture_torque_the_books_agree_with_the_audit_within_half_a_percent(promp):
    config, after = pushed(promp, posture=False)
    assert after["done"].all()
    assert (config.e_max - after["tank_energy"] > 0.3).all()
    check_books(config, after, 0.005)  # measured: 0.1 %, and at most 0.21 % for one of 128 episodes


def test_at_half_the_control_rate_the_accounting_agrees_with_the_audit_as_well(promp):
    # Less damping than usual: at 50 Hz the critically damped arm trembles.
    config, after = pushed(promp, posture=False, control_dt=0.02, damping_ratio=0.5)
    assert after["done"].all()
    assert (after["control_steps"] == 150).all()
    check_books(config, after, 0.01)  # measured: 0.3 %


#: The first second of an episode with the valve at work in half of the rows: else two wrong tanks below were right.
SECOND = {"steps": 100, "posture": False, "p_max": 0.5}
TOLERANCE = 0.02  # measured: 0.5 %, and 0.6 and 0.7 % for two sets of 64


def test_the_books_agree_with_the_audit_while_the_valve_throttles(promp):
    config, after = pushed(promp, **SECOND)
    assert (after["control_steps"] == 100).all()
    check_books(config, after, TOLERANCE)


class ShortStepTank(EnergyTankTransform):
    """Takes the control step for a tenth of what it is."""

    dt = EnergyTankTransform.dt.getter(lambda self: 0.1 * EnergyTankTransform.dt.fget(self))


class BlindTank(EnergyTankTransform):
    """Its flow is zero."""

    def _flow(self, tensordict, effort):
        return torch.zeros_like(effort)


class LateTank(EnergyTankTransform):
    """Its flow is five control steps old."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.seen = []

    def _flow(self, tensordict, effort):
        self.seen.append(super()._flow(tensordict, effort))
        return self.seen[max(0, len(self.seen) - 6)]


class OneAxisBlindTank(EnergyTankTransform):
    """It does not see the tool move along x."""

    def _flow(self, tensordict, effort):
        return super()._flow(tensordict, effort) * torch.tensor([0.0, 1.0, 1.0, 1.0, 1.0, 1.0])


class LouderAfterTank(EnergyTankTransform):
    """What comes after it doubles the wrench, as where the tank stands before a gain."""

    def _inv_call(self, tensordict):
        tensordict = super()._inv_call(tensordict)
        return tensordict.set("action", 2 * tensordict["action"])


class BypassedTank(EnergyTankTransform):
    """It books as if its valve acted, and the wrench passes by it."""

    def _inv_call(self, tensordict):
        wrench = tensordict["action"]
        return super()._inv_call(tensordict).set("action", wrench)


class NominalTank(EnergyTankTransform):
    """It charges what it was asked for, not what its valve let through."""

    def _inv_call(self, tensordict):
        effort, level = tensordict["action"], tensordict["tank_energy"]
        power = (effort * self._flow(tensordict, effort)).sum(-1, keepdim=True).abs()
        tensordict = super()._inv_call(tensordict)
        self._stash(tensordict, "tank_energy", (level - power * self.dt).clamp(0.0, self.e_max))
        return tensordict


class FreeBrakesTank(EnergyTankTransform):
    """It charges pushing only; the audit, like the paper, charges braking as well."""

    def _inv_call(self, tensordict):
        effort, level = tensordict["action"], tensordict["tank_energy"]
        brakes = (effort * self._flow(tensordict, effort)).sum(-1, keepdim=True) < 0
        tensordict = super()._inv_call(tensordict)
        self._stash(tensordict, "tank_energy", torch.where(brakes, level, tensordict["_tank_energy"]))
        return tensordict


class RefilledTank(EnergyTankTransform):
    """A millijoule comes back from nowhere with every control step."""

    def _inv_call(self, tensordict):
        tensordict["tank_energy"] = (tensordict["tank_energy"] + 0.001).clamp_max(self.e_max)
        return super()._inv_call(tensordict)


# A flow of the wrong sign is not among them: the tank takes the size of the power, so such a tank is a right one. Nor
# is a flow that is one control step old: it moves these books by 1.6 %, which the tolerance lets pass.
@pytest.mark.parametrize(
    "tank",
    [
        ShortStepTank, BlindTank, LateTank, OneAxisBlindTank, LouderAfterTank, BypassedTank, NominalTank,
        FreeBrakesTank, RefilledTank,
    ],
)  # fmt: skip
def test_a_wrong_tank_is_caught_by_the_same_check(promp, tank):
    config, after = pushed(promp, tank=tank, **SECOND)
    with pytest.raises(AssertionError, match="books are off"):
        check_books(config, after, TOLERANCE)
