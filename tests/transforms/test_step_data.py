"""Control steps with plain entries are those with a TensorDict, bit for bit."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import Compose, RewardSum, StepCounter, Transform, TransformedEnv

from ppt_rl.arms import PANDA
from ppt_rl.envs import PandaMazeEnv, PandaPushEnv
from ppt_rl.modules import CartesianImpedanceController, Kinematics
from ppt_rl.transforms import (
    EnergyPenaltyTransform,
    EnergyTankTransform,
    ImpedanceTransform,
    JointTorqueTransform,
    MacroStepTransform,
)
from ppt_rl.transforms.chain import step_inside
from ppt_rl.transforms.step_data import PlainStep, StepData
from tests.engines import ONE_THREAD
from tests.sampling import normal
from tests.transforms.cases import CASES, control_chain, make_env, make_nested, push_env, sliding_env

MASKS = [None, torch.tensor([True, False, True]), torch.tensor([False, False, False])]


def assert_same(found, expected: TensorDictBase) -> None:
    assert set(found.keys(True, True)) == set(expected.keys(True, True))
    for key in expected.keys(True, True):
        torch.testing.assert_close(found.get(key), expected.get(key), rtol=0.0, atol=0.0)


# -- the entries -------------------------------------------------------------------------------------------------------


def entries() -> TensorDict:
    return TensorDict({"a": normal(3, 2), "nest": {"b": normal(3, 1), "deep": {"c": normal(3)}}}, [3])


def test_it_reads_as_the_tensordict_does():
    td = entries()
    plain = StepData.of(td)
    assert (plain.batch_size, plain.shape, plain.ndim, plain.device) == (td.batch_size, td.shape, td.ndim, td.device)
    for leaves in (True, False):
        assert set(plain.keys(True, leaves)) == set(td.keys(True, leaves))
    assert set(plain.keys()) == set(td.keys())
    for key in ("a", ("a",), ("nest", "b"), ("nest", "deep", "c")):
        assert plain.get(key) is td.get(key)
    for key in ("z", ("nest", "z"), ("z", "b"), ("a", "b"), ("nest", "deep", "c", "d")):
        assert plain.get(key, None) is None
        assert plain.get(key, 5) == 5


def test_it_writes_as_the_tensordict_does_and_a_copy_leaves_the_original_alone():
    td = entries()
    plain = StepData.of(td)
    copy, expected = plain.copy(), td.copy()
    for key in ("a", "new", ("nest", "b"), ("nest", "new"), ("other", "deep", "d")):
        value = normal(3, 1, seed=1)
        assert copy.set(key, value) is copy
        expected.set(key, value)
    assert_same(copy, expected)
    assert_same(plain, td)
    assert_same(TensorDict(copy, [3]), expected)
    assert not plain.empty().keys()
    assert plain.empty().batch_size == td.batch_size


# -- every transform ---------------------------------------------------------------------------------------------------


def stepped(env: TransformedEnv, given: TensorDict) -> StepData:
    """A control step with plain entries; the mock environment itself makes a TensorDict."""
    root = env.transform._inv_call(StepData.of(given))
    following = env.base_env._step(TensorDict(root, root.batch_size))
    return env.transform._step(root, StepData.of(following))


@pytest.mark.parametrize("mask", MASKS, ids=["all", "some", "none"])
@pytest.mark.parametrize("make", [make_env, make_nested], ids=["flat", "nested"])
@pytest.mark.parametrize("name", [name for name in CASES if name != "MacroStepTransform"])
def test_a_transform_does_with_plain_entries_what_it_does_with_a_tensordict(name, make, mask):
    one, other = make(name, (3,)), make(name, (3,))
    root = one.reset()
    other.reset()
    for number in range(2):
        for key, spec in one.full_action_spec.items(True, True):
            root.set(key, 0.1 * normal(*spec.shape, seed=number).to(spec.dtype))
        given = root.copy() if mask is None else root.copy().set("_step", mask)
        expected = one.transform._step(*_with_root(one, given))
        assert_same(stepped(other, given), expected)
        root = one._step_mdp(root.set("next", expected))


def _with_root(env: TransformedEnv, given: TensorDict) -> tuple[TensorDictBase, TensorDictBase]:
    root = env.transform._inv_call(given.copy())
    return root, env.base_env._step(root)


# -- environments ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mask", [None, torch.tensor([True, False])], ids=["all", "some"])
@pytest.mark.parametrize("task", ["push", "maze"])
def test_a_plain_step_of_an_environment_is_its_step(task, mask):
    def make() -> TransformedEnv:
        if task == "push":
            return push_env(2, *control_chain(), seed=3)
        return sliding_env(PandaMazeEnv.straight(2, duration=0.5, seed=3, engine=ONE_THREAD))

    one, other = make(), make()
    assert PlainStep.of(one) is not None
    root = one.reset()
    other.reset()
    for _ in range(12):  # over the end of a push
        root["action"] = torch.cat([root["pose"] + 0.01, torch.zeros(2, 6)], -1)
        given = root.copy() if mask is None else root.copy().set("_step", mask)
        expected = step_inside(one, given)
        assert_same(PlainStep.of(other)(StepData.of(given)), expected)
        root = one._step_mdp(root.set("next", expected))


class Erasing(CartesianImpedanceController):
    """A controller from elsewhere that writes into what it is given, so that no velocity seems to be there."""

    def forward(self, pose: torch.Tensor, twist: torch.Tensor, *args: torch.Tensor) -> torch.Tensor:
        wrench = super().forward(pose, twist, *args)
        twist.zero_()
        return wrench


def test_a_controller_that_writes_in_place_changes_nothing_of_what_a_tank_reads():
    levels = []
    for controller in (CartesianImpedanceController(), Erasing()):
        tank, impedance = EnergyTankTransform(p_max=0.1, flow_key="twist"), ImpedanceTransform(controller)
        torque = JointTorqueTransform(Kinematics(PANDA, PandaPushEnv.tool.length))
        env = push_env(2, torque, tank, impedance, MacroStepTransform(8, trace_keys=["valve"]), seed=2)
        td = env.reset()
        ahead = torch.cat([td["pose"] + torch.tensor([0.05, *[0.0] * 6]), torch.zeros(2, 6)], -1)
        levels.append(env.step(td.set("action", ahead.unsqueeze(1).repeat(1, 8, 1)))["next", "trace", "valve"])
    assert levels[0].amin() < 0.9
    torch.testing.assert_close(levels[1], levels[0], rtol=0.0, atol=0.0)


class Looking(EnergyPenaltyTransform):
    """A transform from elsewhere, which uses what only a TensorDict can do."""

    def _after_step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        assert isinstance(next_tensordict.clone(), TensorDictBase)
        return super()._after_step(tensordict, next_tensordict.select(*next_tensordict.keys()))


class Halving(PandaPushEnv):
    """An environment that changes what a step returns."""

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        following = super()._step(tensordict)
        return following.set("reward", 0.5 * following["reward"])


@pytest.mark.parametrize("foreign", [StepCounter, RewardSum, Looking])
def test_a_transform_from_elsewhere_gets_a_tensordict(foreign: type[Transform]):
    env = push_env(2, EnergyTankTransform(), foreign())
    assert PlainStep.of(env) is None
    env = push_env(2, EnergyTankTransform(), foreign(), MacroStepTransform(3))
    td = env.reset()
    assert env.step(td.set("action", torch.zeros(2, 3, 7)))["next", "control_steps"].eq(3).all()


class Twice(Compose):
    """Transforms in a list from elsewhere, which does more than to apply one after the other."""

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        following = super()._step(tensordict, next_tensordict)
        return following.set("reward", 2.0 * following["reward"])


def test_a_list_of_transforms_from_elsewhere_is_asked_for_the_step():
    rewards = []
    for cls in (Compose, Twice):
        inside = TransformedEnv(push_env(2, seed=1), cls(EnergyTankTransform()))
        assert (PlainStep.of(inside) is None) == (cls is Twice)
        env = TransformedEnv(inside, MacroStepTransform(3), auto_unwrap=False)
        rewards.append(env.step(env.reset().set("action", normal(2, 3, 7)))["next", "reward"])
    torch.testing.assert_close(rewards[1], 2.0 * rewards[0])


def test_an_environment_that_changes_its_step_is_asked_for_it():
    chunk, chain = 0.5 * normal(2, 5, 7), [EnergyTankTransform(), MacroStepTransform(5)]
    rewards = []
    for cls in (PandaPushEnv, Halving):
        base = cls(2, seed=1, engine=ONE_THREAD)
        env = TransformedEnv(base, chain[0].clone()).append_transform(chain[1].clone())
        assert base.can_step_plainly == (cls is PandaPushEnv)
        rewards.append(env.step(env.reset().set("action", chunk))["next", "reward"])
    torch.testing.assert_close(rewards[1], 0.5 * rewards[0])


def test_an_environment_whose_step_was_replaced_before_its_chain_was_made_is_asked_for_it():
    base = PandaPushEnv(2, seed=1, engine=ONE_THREAD)
    step, calls = base._step, []
    base._step = lambda tensordict: calls.append(1) or step(tensordict)
    env = TransformedEnv(base, EnergyTankTransform()).append_transform(MacroStepTransform(4))
    env.step(env.reset().set("action", torch.zeros(2, 4, 7)))
    assert len(calls) == 4


def test_an_environment_of_the_library_steps_plainly_alone_and_one_from_elsewhere_does_not():
    assert PlainStep.of(PandaPushEnv(1, engine=ONE_THREAD)) is not None
    assert PlainStep.of(make_env("EnergyTankTransform", (3,))) is None
    assert PlainStep.of(TransformedEnv(PandaPushEnv(1, engine=ONE_THREAD), StepCounter())) is None
    assert JointTorqueTransform.__module__.startswith("ppt_rl.")
