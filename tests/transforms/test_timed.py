"""Where transforms take the control step from, and what they refuse."""

from __future__ import annotations

import copy
import pickle
from functools import partial

import pytest
import torch
from torchrl.envs import Compose, ParallelEnv, PendulumEnv, SerialEnv, StepCounter, TransformedEnv

from ppt_rl.arms import PANDA
from ppt_rl.envs import PandaPushEnv
from ppt_rl.modules import Kinematics
from ppt_rl.transforms import EnergyTankTransform, EpisodeMetricsTransform, JointTorqueTransform, MacroStepTransform
from ppt_rl.transforms.timed import control_step
from tests.engines import ONE_THREAD
from tests.transforms.cases import CASES, control_chain, make_base, make_env
from tests.transforms.mocks import MockArmEnv, actions_for, play

TIMED = sorted(name for name, case in CASES.items() if case.timed)
each_timed = pytest.mark.parametrize("name", TIMED)


class StepEnv(MockArmEnv):
    """An arm whose control step is not that of the other tests."""

    control_dt = 0.05


def foreign(name: str):
    """The environment of a case without the attribute ``control_dt``."""
    base = make_base(name, (2,))
    base.control_dt = None
    return base


# -- in an environment -------------------------------------------------------------------------------------------------


@each_timed
def test_the_control_step_is_that_of_the_environment(name):
    base = make_base(name, (2,))
    base.control_dt = 0.02
    env = TransformedEnv(base, CASES[name].make())
    env.reset()
    assert env.transform.dt == 0.02


@each_timed
def test_a_control_step_that_disagrees_is_refused_before_the_first_reset_with_both_values_and_the_remedy(name):
    env = TransformedEnv(make_base(name, (2,)), CASES[name].make(dt=0.02))
    message = rf"{name} has dt=0\.02 s and its environment control_dt=0\.01 s; .*Leave dt out, or correct"
    with pytest.raises(ValueError, match=message):
        env.reset()
    with pytest.raises(ValueError, match=message):
        _ = env.observation_spec
    with pytest.raises(ValueError, match=message):
        _ = env.input_spec


@each_timed
def test_an_equal_control_step_may_be_given_and_gives_the_same_values(name):
    given, taken = TransformedEnv(make_base(name, (2,)), CASES[name].make(dt=0.01)), make_env(name, (2,))
    actions = actions_for(taken, 5)
    expected, reached = play(taken, actions), play(given, actions)
    for key in expected.keys(True, True):
        assert torch.equal(reached[key], expected[key]), key


@pytest.mark.parametrize(("factor", "agrees"), [(1 + 9e-7, True), (1 - 9e-7, True), (1 + 2e-6, False)])
def test_two_steps_agree_within_a_relative_tolerance_of_one_in_a_million(factor, agrees):
    env = TransformedEnv(MockArmEnv((2,)), EnergyTankTransform(dt=0.01 * factor))
    if agrees:
        env.reset()
        assert env.transform.dt == 0.01
    else:
        with pytest.raises(ValueError, match="expected the same"):
            env.reset()


@pytest.mark.parametrize("bad", [0.0, -0.01, float("nan"), float("inf")])
def test_an_environment_with_an_impossible_control_step_is_refused(bad):
    base = MockArmEnv((2,))
    base.control_dt = bad
    with pytest.raises(ValueError, match=rf"control_dt of MockArmEnv is {bad}; expected a finite number above 0 s"):
        TransformedEnv(base, EnergyTankTransform()).reset()


@pytest.mark.parametrize("dt", [0.02, 0.005])
def test_the_tank_charges_power_times_the_control_step_of_the_simulated_arm(dt):
    env = TransformedEnv(PandaPushEnv(2, control_dt=dt, engine=ONE_THREAD, seed=0), EnergyTankTransform())
    steps = play(env, actions_for(env, 10, scale=20.0))
    power = steps["next", "valve"] * (steps["action"] * steps["joint_velocity"]).sum(-1, keepdim=True).abs()
    spent = steps["tank_energy"][:, 0] - steps["next", "tank_energy"][:, -1]
    assert (spent > 0.01).all()
    torch.testing.assert_close(spent, dt * power.sum(1), rtol=1e-3, atol=1e-5)


# -- environments of others --------------------------------------------------------------------------------------------


@each_timed
def test_an_environment_without_a_control_step_needs_dt_and_the_error_says_so(name):
    message = rf"{name} needs the control step and has MockArmEnv without .*Pass dt= \[s\], or give .*`control_dt`"
    with pytest.raises(ValueError, match=message):
        TransformedEnv(foreign(name), CASES[name].make()).reset()


@each_timed
def test_in_an_environment_without_a_control_step_the_given_one_holds(name):
    env = TransformedEnv(foreign(name), CASES[name].make(dt=0.01))
    expected, reached = (play(e, actions_for(e, 3)) for e in (make_env(name, (2,)), env))
    assert env.transform.dt == 0.01
    for key in CASES[name].state:
        assert torch.equal(reached["next", key], expected["next", key])


def test_torchrls_own_pendulum_takes_a_given_step_or_an_attribute_of_its_own():
    def spent(base, **kwargs):
        env = TransformedEnv(base, EnergyTankTransform(flow_key="thdot", **kwargs))
        torch.manual_seed(0)
        env.base_env.set_seed(0)
        return env.rollout(5, lambda td: td.set("action", torch.ones(1)))["next", "tank_energy"]

    named = PendulumEnv()
    named.control_dt = 0.05
    assert torch.equal(spent(PendulumEnv(), dt=0.05), spent(named))
    with pytest.raises(ValueError, match="EnergyTankTransform needs the control step and has PendulumEnv without"):
        spent(PendulumEnv())


def test_joint_torque_without_a_rate_limit_needs_no_control_step_but_refuses_a_wrong_one():
    base = MockArmEnv((2,))
    base.control_dt = None
    play(TransformedEnv(base, JointTorqueTransform(Kinematics(PANDA, 0.1))), torch.zeros(2, 2, 6))
    with pytest.raises(ValueError, match=r"JointTorqueTransform has dt=0\.02 s"):
        TransformedEnv(MockArmEnv((2,)), JointTorqueTransform(Kinematics(PANDA, 0.1), dt=0.02)).reset()


def test_a_cutoff_that_the_control_rate_of_the_environment_is_too_slow_for_is_refused():
    base = MockArmEnv((2,))
    base.control_dt = 0.05
    with pytest.raises(ValueError, match=r"cutoff is 10\.0 Hz; .*half the control rate, 10\.0 Hz"):
        TransformedEnv(base, EpisodeMetricsTransform()).reset()


# -- layers of environments --------------------------------------------------------------------------------------------


def test_layers_of_transformed_environments_are_looked_through():
    inner = TransformedEnv(TransformedEnv(StepEnv((2,)), StepCounter()), StepCounter(), auto_unwrap=False)
    assert control_step(inner) == 0.05
    env = TransformedEnv(inner, EnergyTankTransform(), auto_unwrap=False)
    env.reset()
    assert env.transform.dt == 0.05


@pytest.mark.parametrize("batched", [SerialEnv, partial(ParallelEnv, mp_start_method="forkserver")])
def test_on_environments_in_workers_the_step_is_given_or_set_on_all_of_them_together(batched):
    env = batched(2, MockArmEnv)
    assert control_step(env) is None
    with pytest.raises(ValueError, match=r"Env without a `control_dt` attribute\. Pass dt="):
        TransformedEnv(env, EnergyTankTransform()).reset()
    env.control_dt = 0.02
    assert control_step(env) == 0.02
    assert control_step(SerialEnv(1, MockArmEnv)) is None
    with pytest.raises(ValueError, match=r"dt=0\.01 s .* control_dt=0\.02 s"):
        TransformedEnv(env, EnergyTankTransform(dt=0.01)).reset()


def test_under_a_macro_step_the_control_step_remains_that_of_the_base_environment():
    env = TransformedEnv(MockArmEnv((2,)), Compose(*control_chain(), MacroStepTransform(5)))
    env.reset()
    assert [t.dt for t in env.transform if hasattr(type(t), "dt")] == [0.01] * 3


# -- a transform that moves --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("copied", [lambda t: t.clone(), copy.deepcopy, lambda t: pickle.loads(pickle.dumps(t))])
@pytest.mark.parametrize("used", [False, True], ids=["fresh", "used"])
def test_a_copy_takes_the_control_step_of_the_environment_that_it_is_put_on(copied, used):
    tank = EnergyTankTransform()
    first = TransformedEnv(MockArmEnv((2,)), tank)
    if used:
        first.reset()
    twin = copied(tank)
    twin.reset_parent()
    second = TransformedEnv(StepEnv((2,)), twin)
    second.reset()
    assert (tank.dt, twin.dt) == (0.01, 0.05)


def test_a_transform_that_is_moved_takes_the_control_step_of_its_new_environment():
    tank = EnergyTankTransform()
    first = TransformedEnv(MockArmEnv((2,)), tank)
    first.reset()
    assert tank.dt == 0.01
    first.transform = Compose()
    second = TransformedEnv(StepEnv((2,)), Compose(StepCounter(), tank))
    second.reset()
    assert tank.dt == 0.05


def test_a_transform_that_is_appended_later_is_checked_then():
    env = TransformedEnv(StepEnv((2,)), Compose(StepCounter()))
    env.reset()
    env.append_transform(EnergyTankTransform())
    env.reset()
    assert env.transform[1].dt == 0.05
    env.transform.append(EpisodeMetricsTransform(dt=0.01))
    with pytest.raises(ValueError, match=r"EpisodeMetricsTransform has dt=0\.01 s .* control_dt=0\.05 s"):
        env.reset()


def test_a_control_step_that_is_set_later_is_compared_like_a_given_one():
    env = TransformedEnv(MockArmEnv((2,)), EnergyTankTransform())
    env.reset()
    env.transform.dt = 0.02
    with pytest.raises(ValueError, match=r"dt=0\.02 s .* control_dt=0\.01 s"):
        _ = env.transform.dt


# -- without an environment --------------------------------------------------------------------------------------------


@each_timed
def test_without_an_environment_the_control_step_is_the_given_one_and_else_an_error(name):
    assert CASES[name].make(dt=0.01).dt == 0.01
    with pytest.raises(ValueError, match=rf"{name} needs the control step and has no environment\. Pass dt="):
        _ = CASES[name].make().dt


@each_timed
@pytest.mark.parametrize("bad", [0.0, -0.01, float("nan"), float("inf")])
def test_an_impossible_control_step_is_refused_with_what_came(name, bad):
    with pytest.raises(ValueError, match=rf"dt is {bad}; expected a finite number above 0 s"):
        CASES[name].make(dt=bad)
