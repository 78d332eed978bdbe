"""What TorchRL asks of its own transforms, asked of every transform here."""

from __future__ import annotations

import copy
import inspect
import multiprocessing
from functools import partial

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.data import Composite, LazyTensorStorage, ReplayBuffer
from torchrl.envs import Compose, EnvBase, ParallelEnv, RewardSum, SerialEnv, StepCounter, Transform, TransformedEnv
from torchrl.envs.utils import check_env_specs

import ppt_rl.transforms
from tests.transforms.cases import CASES, make_base, make_chain_env, make_env, make_nested, standalone, stored
from tests.transforms.mocks import actions_for, play

every_transform = pytest.mark.parametrize("name", sorted(CASES))
#: Those that only look at what follows a step.
OBSERVING = (
    "ContactViaPointTransform",
    "EnergyPenaltyTransform",
    "EpisodeMetricsTransform",
    "HeadingFrameTransform",
    "MotionMemoryTransform",
)
every_batch = pytest.mark.parametrize("batch", [(), (2,), (2, 1)], ids=str)

# Workers fork from a server that has imported the library once, instead of importing it again each.
multiprocessing.get_context("forkserver").set_forkserver_preload(["torchrl.envs", "ppt_rl.envs", "ppt_rl.transforms"])


def assert_same(one: TensorDictBase, other: TensorDictBase) -> None:
    assert set(one.keys(True, True)) == set(other.keys(True, True))
    for key in one.keys(True, True):
        torch.testing.assert_close(one[key], other[key], rtol=0.0, atol=0.0, msg=lambda text, key=key: f"{key}: {text}")


def assert_close(one: TensorDictBase, other: TensorDictBase) -> None:
    assert set(one.keys(True, True)) == set(other.keys(True, True))
    for key in one.keys(True, True):
        torch.testing.assert_close(
            one[key], other[key], rtol=1e-5, atol=1e-5, msg=lambda text, key=key: f"{key}: {text}"
        )


def leaves(spec: Composite) -> set:
    return set(spec.keys(True, True))


def test_every_public_transform_has_a_case():
    public = [name for name in ppt_rl.transforms.__all__ if issubclass(getattr(ppt_rl.transforms, name), Transform)]
    assert sorted(CASES) == sorted(public)


@every_transform
def test_a_constructor_has_at_most_eight_arguments_besides_keys(name):
    parameters = inspect.signature(getattr(ppt_rl.transforms, name)).parameters
    assert len([parameter for parameter in parameters if not parameter.endswith(("_key", "_keys"))]) <= 8


# -- environments ------------------------------------------------------------------------------------------------------


@every_transform
@every_batch
def test_specs_hold_on_a_single_environment(name, batch):
    check_env_specs(make_env(name, batch), break_when_any_done="both")


@every_transform
def test_specs_hold_in_double_precision(name):
    env = make_env(name, (2,), dtype=torch.float64)
    check_env_specs(env)
    floating = [spec.dtype for spec in env.observation_spec.values(True, True) if spec.dtype.is_floating_point]
    assert set(floating) == {torch.float64}


@every_transform
def test_specs_hold_on_a_serial_env_of_transformed_environments(name):
    check_env_specs(SerialEnv(2, partial(make_env, name)))


@every_transform
def test_specs_hold_on_a_transformed_serial_env(name):
    check_env_specs(TransformedEnv(SerialEnv(2, partial(make_base, name)), standalone(name)))


@every_transform
def test_a_transformed_serial_env_equals_a_serial_env_of_transformed_environments(name):
    outside = TransformedEnv(SerialEnv(2, partial(make_base, name)), standalone(name))
    inside = SerialEnv(2, partial(make_env, name))
    actions = actions_for(inside, 5)
    outside.set_seed(7)
    inside.set_seed(7)
    assert_close(play(outside, actions), play(inside, actions))


@every_transform
def test_a_parallel_env_of_transformed_environments_keeps_the_specs_and_equals_a_serial_one(name):
    serial = SerialEnv(2, partial(make_env, name))
    parallel = ParallelEnv(2, partial(make_env, name), mp_start_method="forkserver")
    try:
        check_env_specs(parallel)
        actions = actions_for(serial, 5)
        serial.set_seed(7)
        parallel.set_seed(7)
        assert_close(play(parallel, actions), play(serial, actions))
    finally:
        parallel.close()


@every_transform
def test_specs_and_values_hold_inside_a_compose(name):
    alone = make_env(name, (2,))
    composed = TransformedEnv(make_base(name, (2,)), Compose(CASES[name].make(), StepCounter(), RewardSum()))
    check_env_specs(composed)
    actions = actions_for(alone, 5)
    alone.set_seed(7)
    composed.set_seed(7)
    expected, reached = play(alone, actions), play(composed, actions)
    assert_same(reached.select(*expected.keys(True, True)), expected)


@every_transform
def test_specs_hold_with_nested_keys(name):
    check_env_specs(make_nested(name, (2,)), break_when_any_done="both")


@every_transform
def test_nested_keys_give_the_values_of_flat_keys(name):
    flat, nested = make_env(name, (2,)), make_nested(name, (2,))
    actions = actions_for(flat, 5)
    expected, reached = play(flat, actions), play(nested, actions)
    assert set(map(str, CASES[name].state)) <= set(reached.keys())
    for key in [*CASES[name].state, *CASES[name].written, "executed", "reward"]:
        nest = (key,) if isinstance(key, str) else key
        where = ("agent", *nest) if name == "ViaPointTransform" and key in CASES[name].written else nest
        torch.testing.assert_close(reached["next", *where], expected["next", *nest], rtol=0, atol=0)


def test_specs_hold_for_the_whole_chain_on_the_simulated_arm():
    env = make_chain_env()
    check_env_specs(env, break_when_any_done="both")


def test_specs_hold_for_the_whole_chain_in_double_precision():
    check_env_specs(make_chain_env(dtype=torch.float64))


def test_the_whole_chain_gives_the_same_values_in_serial_and_parallel_environments():
    make = partial(make_chain_env, 1)
    serial, parallel = SerialEnv(2, make), ParallelEnv(2, make, mp_start_method="forkserver")
    try:
        actions = actions_for(serial, 3)
        serial.set_seed(7)
        parallel.set_seed(7)
        assert_close(play(parallel, actions), play(serial, actions))
    finally:
        parallel.close()
        serial.close()


# -- specs and keys ----------------------------------------------------------------------------------------------------


@every_transform
@pytest.mark.parametrize("make", [make_env, make_nested])
def test_reset_and_step_give_exactly_the_declared_keys(name, make):
    env = make(name, (2,))
    done = leaves(env.full_done_spec)
    root = env.reset()
    assert set(root.keys(True, True)) == leaves(env.observation_spec) | done
    root[env.action_key] = actions_for(env, 1)[0]
    following = env.step(root)["next"]
    assert set(following.keys(True, True)) == leaves(env.observation_spec) | done | leaves(env.full_reward_spec)


@every_transform
def test_every_value_lies_in_its_spec_over_whole_episodes(name):
    env = make_env(name, (2,))
    steps = play(env, actions_for(env, 9, scale=3.0))["next"]
    for key, spec in env.observation_spec.items(True, True):
        for step in steps[key].unbind(1):
            assert spec.is_in(step), key


@every_transform
def test_state_and_written_keys_are_the_documented_ones(name):
    env = make_env(name, (2,))
    case = CASES[name]
    added = leaves(env.observation_spec) - leaves(env.base_env.observation_spec)
    assert leaves(env.full_state_spec) == set(case.state)
    assert added == {*case.state, *case.written}
    assert env.full_action_spec["action"].shape == (2, *case.outer)


# -- state -------------------------------------------------------------------------------------------------------------


@every_transform
def test_a_partial_reset_touches_only_its_rows(name):
    env = make_env(name, (3,))
    odd = env.reset()
    for i, key in enumerate(CASES[name].state):
        odd[key] = torch.full_like(odd[key], 0.011 + 0.001 * i)
    odd["_reset"] = torch.tensor([[False], [True], [False]])
    env.set_seed(5)
    fresh = env.reset()
    env.set_seed(5)
    reached = env.reset(odd.clone())
    for key in leaves(env.observation_spec):
        torch.testing.assert_close(reached[key][1], fresh[key][1], rtol=0, atol=0)
        torch.testing.assert_close(reached[key][[0, 2]], odd[key][[0, 2]], rtol=0, atol=0)


@every_transform
def test_the_transforms_own_reset_keeps_the_state_of_the_other_rows(name):
    env = make_env(name, (3,))
    odd = env.reset()
    for i, key in enumerate(CASES[name].state):
        odd[key] = torch.full_like(odd[key], 0.011 + 0.001 * i)
    odd["_reset"] = torch.tensor([[False], [True], [False]])
    reached = env._reset(odd)
    for key in CASES[name].state:
        torch.testing.assert_close(reached[key][[0, 2]], odd[key][[0, 2]], rtol=0, atol=0)
        assert not torch.equal(reached[key][1], odd[key][1])


@every_transform
def test_rows_outside_the_step_mask_stand_still_and_the_others_step(name):
    env = make_env(name, (3,))
    root = play(env, actions_for(env, 1, seed=1))[:, -1]["next"].exclude("reward")
    root["action"] = actions_for(env, 1)[0]
    full = env.step(root.clone())["next"]
    masked = env.step(root.clone().set("_step", torch.tensor([True, False, True])))["next"]
    outputs = {"control_steps", ("trace", "joint_velocity"), "cost"}
    for key in leaves(env.observation_spec) | {"reward"}:
        torch.testing.assert_close(masked[key][[0, 2]], full[key][[0, 2]], rtol=0, atol=0)
    for key in leaves(env.base_env.observation_spec) | set(CASES[name].state):
        if key[0] != "reward_terms":
            torch.testing.assert_close(masked[key][1], root[key][1], rtol=0, atol=0)
    for key in {"reward", *outputs} & set(masked.keys(True, True)):
        assert not masked[key][1].any(), key


@every_transform
def test_two_trajectories_interleaved_through_one_environment_equal_separate_runs(name):
    def separate(seed: int) -> list[TensorDictBase]:
        env = make_env(name, (2,))
        env.set_seed(seed)
        td, steps = env.reset(), []
        for action in actions_for(env, 3, seed=seed):
            td = env.step(td.set("action", action))
            steps.append(td)
            td = env._step_mdp(td)
        return steps

    env = make_env(name, (2,))
    roots = []
    for seed in (1, 2):
        env.set_seed(seed)
        roots.append(env.reset())
    for i in range(3):
        for j, seed in enumerate((1, 2)):
            td = env.step(roots[j].set("action", actions_for(env, 3, seed=seed)[i]))
            assert_same(td, separate(seed)[i])
            roots[j] = env._step_mdp(td)


@every_transform
def test_a_clone_and_a_deep_copy_share_no_state_with_the_original(name):
    original = CASES[name].make()
    first = TransformedEnv(make_base(name, (2,)), original)
    expected = play(first, actions_for(first, 5))
    for transform in (original.clone(), copy.deepcopy(CASES[name].make())):
        env = TransformedEnv(make_base(name, (2,)), transform)
        interleaved = play(env, actions_for(env, 5))
        play(first, actions_for(first, 2, seed=9))
        assert_same(interleaved, expected)


@every_transform
def test_a_rollout_leaves_no_tensor_or_tensordict_on_the_transform(name):
    env = make_env(name, (2,))

    def held() -> dict:
        return {
            key: value for key, value in vars(env.transform).items() if isinstance(value, torch.Tensor | TensorDictBase)
        }

    def buffers() -> list[torch.Tensor]:
        return [value.clone() for value in env.transform.state_dict().values()]

    before = buffers()
    play(env, actions_for(env, 5))
    assert held() == {}
    assert all(torch.equal(a, b) for a, b in zip(before, buffers(), strict=True))


@every_transform
def test_stepping_again_over_a_stale_next_gives_the_same_step(name):
    env = make_env(name, (2,))
    root = env.reset()
    first, second = actions_for(env, 2)
    expected = env.step(root.clone().set("action", second))
    stale = env.step(root.clone().set("action", first))
    assert_same(env.step(stale.set("action", second)), expected)


# -- without an environment --------------------------------------------------------------------------------------------


@every_transform
def test_forward_without_an_environment_adds_only_what_is_documented(name):
    td = stored(name)
    out = standalone(name)(td.clone())
    assert set(out.keys(True, True)) - set(td.keys(True, True)) == set(CASES[name].forward)
    assert_same(out.select(*td.keys(True, True)), td)


@every_transform
def test_inverse_without_an_environment_maps_the_action_and_leaves_the_callers_tensordict_untouched(name):
    td, transform = stored(name), standalone(name)
    before = td.clone()
    if name == "MacroStepTransform":
        with pytest.raises(RuntimeError, match="append it to a TransformedEnv"):
            transform.inv(td)
    else:
        out = transform.inv(td)
        assert out["action"].shape == (4, *CASES[name].inner)
        assert set(out.keys(True, True)) == set(td.keys(True, True))
    assert_same(td, before)


@every_transform
def test_inverse_gives_the_action_that_the_environment_executes(name):
    env = make_env(name, (2,))
    root = env.reset()
    root["action"] = actions_for(env, 1)[0]
    before = root.clone()
    inverted = env.transform.inv(root)["action"]
    assert_same(root, before)
    stepped = env.step(root)
    torch.testing.assert_close(stepped["next", "executed"], inverted, rtol=0, atol=0)
    torch.testing.assert_close(stepped["action"], before["action"], rtol=0, atol=0)


@every_transform
@pytest.mark.parametrize("container", [nn.Sequential, TensorDictSequential])
def test_a_model_may_begin_with_the_transform(name, container):
    td = stored(name)
    module = TensorDictModule(nn.Linear(6, 2), in_keys=["twist"], out_keys=["value"])
    out = container(standalone(name), module)(td.clone())
    torch.testing.assert_close(out["value"], module(td.clone())["value"])
    assert {*CASES[name].forward} <= set(out.keys(True, True))


@every_transform
def test_a_replay_buffer_stores_the_inverse_and_samples_the_forward(name):
    td, transform = stored(name), standalone(name)
    buffer = ReplayBuffer(storage=LazyTensorStorage(8), batch_size=4)
    buffer.append_transform(standalone(name))
    if name == "MacroStepTransform":
        with pytest.raises(RuntimeError, match="append it to a TransformedEnv"):
            buffer.extend(td)
        return
    buffer.extend(td.clone())
    inverse = transform.inv(td)
    assert_same(buffer.storage[:].select(*td.keys(True, True)), inverse)
    sample = buffer.sample()
    assert {*CASES[name].forward} <= set(sample.keys(True, True))
    index = [int((inverse["offset"] == offset).nonzero()[0, 0]) for offset in sample["offset"]]
    expected = transform(inverse.clone())[index]
    assert_close(sample.select(*expected.keys(True, True)), expected)


# -- errors ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", sorted(set(CASES) - {*OBSERVING, "PowerLimitTransform", "ViaPointTransform"}))
def test_a_missing_action_is_a_key_error_that_names_the_transform(name):
    env: EnvBase = make_env(name, (2,))
    with pytest.raises(KeyError, match=rf"{name} needs .*action"):
        env.step(env.reset())


@every_transform
def test_a_tensordict_without_observations_is_a_key_error_that_names_the_transform(name):
    transform = standalone(name)
    empty = TensorDict({"action": torch.zeros(2, *CASES[name].outer)}, [2])
    if name == "MacroStepTransform":
        with pytest.raises(ValueError, match="no observation"):  # torchrl hides a KeyError in its specs
            TransformedEnv(make_base(name), CASES[name].make(trace_keys=["absent"])).reset()
    elif name in OBSERVING:
        with pytest.raises(KeyError, match=name):
            transform._step(empty, empty)
    elif name in ("PowerLimitTransform", "ViaPointTransform"):
        with pytest.raises(KeyError, match=name):
            transform(empty)
    elif name in (
        "ActionMapTransform", "EnergyBudgetTransform", "HoldActionTransform", "ReferenceVelocityTransform"
    ):  # fmt: skip
        assert transform.inv(empty)["action"].shape == (2, *CASES[name].inner)  # an action is all it needs
    else:
        with pytest.raises(KeyError, match=name):
            transform.inv(empty)
