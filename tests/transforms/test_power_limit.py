from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tensordict import TensorDict
from torch.testing import assert_close
from torchrl.envs import Compose, PendulumEnv, TransformedEnv
from torchrl.envs.utils import check_env_specs

from ppt_rl.transforms import MacroStepTransform, PowerLimitTransform
from tests.engines import COARSE
from tests.transforms.cases import push_env
from tests.transforms.mocks import MockArmEnv, ScriptedEnv, actions_for, play

F64 = torch.float64
LAWS = settings(max_examples=100, deadline=None, derandomize=True)
SIX = st.lists(st.floats(-100.0, 100.0), min_size=6, max_size=6)
#: Measured power of three rows over seven readings, the first at reset [W]; a limit of 2 W is touched and passed.
POWER = torch.tensor(((9, 1, -2, 2, 3, 0, 7, 1), (9, 0, 1, -5, 4, 0, -6, 0), (9, 1, 2, -1, -2, 0, 2, 1))).double()
EXCESS = torch.tensor(((0, 0, 0, 1, 0, 5, 0), (0, 0, 3, 2, 0, 4, 0), (0, 0, 0, 0, 0, 0, 0))).double().unsqueeze(-1)

either_env = pytest.mark.parametrize("honours", [True, False], ids=["honours_step", "ignores_step"])


def scripted(*transforms, **kwargs):
    """An arm that pushes along y with a steady 4 N, at the velocity that gives the power."""
    twist, wrench = torch.zeros(2, 3, 8, 6, dtype=F64)
    wrench[..., 1] = 4.0
    twist[..., 1] = POWER / 4.0
    limit = PowerLimitTransform(2.0, **{"dt": 0.5, **kwargs})
    return TransformedEnv(ScriptedEnv(2, wrench=wrench, twist=twist), Compose(limit, *transforms))


def by_hand(env, steps=7):
    """Steps ``(*B, T)`` without regard to done."""
    td, taken = env.reset(), []
    for action in actions_for(env, steps):
        taken.append(env.step(td.set("action", action)).clone())
        td = env._step_mdp(td)
    return torch.stack(taken, 1)


def measured_cost(readings, p_max, dt=0.01):
    power = torch.einsum("...i,...i", readings["wrench"].double(), readings["twist"].double()).unsqueeze(-1)
    return dt * torch.where(power.abs() > p_max, power.abs() - p_max, 0.0)


# -- the cost ----------------------------------------------------------------------------------------------------------


@LAWS
@given(wrench=SIX, twist=SIX, p_max=st.floats(1e-3, 1e4), dt=st.floats(1e-4, 1.0))
def test_the_cost_is_the_energy_above_the_limit_and_blind_to_the_sign_of_the_power(wrench, twist, p_max, dt):
    power = math.fsum(w * v for w, v in zip(wrench, twist, strict=True))
    expected = torch.full((2, 1), dt * max(0.0, abs(power) - p_max), dtype=F64)
    wrenches, twists = torch.tensor([[wrench, wrench], [twist, [-v for v in twist]]], dtype=F64)
    cost = PowerLimitTransform(p_max, dt=dt)(TensorDict({"wrench": wrenches, "twist": twists}, [2]))["cost"]
    assert_close(cost, expected, rtol=1e-12, atol=1e-9)  # of terms up to 1e4 W each


def test_the_cost_of_a_step_is_that_of_the_reading_after_it_and_zero_at_reset():
    steps = by_hand(scripted())
    assert torch.equal(steps["next", "cost"], 0.5 * EXCESS)
    assert not steps["cost"][:, 0].any()
    assert torch.equal(steps["next", "reward"], torch.ones(3, 7, 1, dtype=F64))


def test_the_environment_executes_the_action_as_it_is():
    steps = by_hand(scripted(penalty=3.0, terminate=True))
    assert torch.equal(steps["next", "executed"], steps["action"])


def test_rows_outside_the_step_mask_have_no_cost_no_penalty_and_no_end():
    env = scripted(penalty=3.0, terminate=True)
    root = by_hand(env, 5)[:, -1]["next"].exclude("reward", "done", "terminated")
    root["action"] = torch.zeros(3, 2, dtype=F64)
    full = env.step(root.clone())["next"]
    masked = env.step(root.clone().set("_step", torch.tensor([False, True, True])))["next"]
    assert full["cost"].flatten().tolist() == [2.5, 2.0, 0.0]
    assert masked["cost"].flatten().tolist() == [0.0, 2.0, 0.0]
    assert masked["reward"].flatten().tolist() == [1.0, -5.0, 1.0]
    assert masked["terminated"].flatten().tolist() == [False, True, False]
    assert masked["done"].flatten().tolist() == [False, True, False]


@pytest.mark.parametrize("batch", [(5,), (5, 3)], ids=str)
def test_stored_readings_get_their_cost_and_keep_their_rewards_and_ends(batch):
    generator = torch.Generator().manual_seed(0)
    readings = {key: torch.randn(*batch, 6, generator=generator) for key in ("wrench", "twist")}
    flags = {key: torch.zeros(*batch, 1, dtype=torch.bool) for key in ("done", "terminated")}
    td = TensorDict({**readings, **flags, "reward": torch.ones(*batch, 1)}, batch)
    out = PowerLimitTransform(1.0, penalty=10.0, terminate=True, dt=0.01)(td.clone())
    assert_close(out["cost"].double(), measured_cost(td, 1.0), rtol=0, atol=1e-6)
    assert 0 < (out["cost"] > 0).sum() < out["cost"].numel()
    for key in td.keys():
        assert torch.equal(out[key], td[key])


def test_nested_keys_give_the_cost_of_flat_keys():
    flat = TransformedEnv(MockArmEnv((2,)), PowerLimitTransform(12.0, penalty=10.0))
    keys = {"wrench_key": ("arm", "wrench"), "twist_key": ("arm", "twist"), "cost_key": ("arm", "cost")}
    nested = TransformedEnv(MockArmEnv((2,), prefix=("arm",)), PowerLimitTransform(12.0, penalty=10.0, **keys))
    check_env_specs(nested)
    nested.set_seed(0)
    actions = actions_for(flat, 5)
    expected, reached = play(flat, actions)["next"], play(nested, actions)["next"]
    assert (expected["cost"] > 0).any()
    assert torch.equal(reached["arm", "cost"], expected["cost"])
    assert torch.equal(reached["reward"], expected["reward"])
    assert "cost" not in reached.keys()


# -- the penalty -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("penalty", [0.0, 0.5, 300.0])
def test_the_penalty_takes_exactly_penalty_times_cost_off_the_reward_and_changes_nothing_else(penalty):
    plain, limited = MockArmEnv((3,), horizons=(20,)), MockArmEnv((3,), horizons=(20,))
    limited = TransformedEnv(limited, PowerLimitTransform(12.0, penalty=penalty))
    actions = actions_for(plain, 8)
    before, after = play(plain, actions)["next"], play(limited, actions)["next"]
    cost = after["cost"]
    assert 0 < (cost > 0).sum() < cost.numel()
    assert torch.equal(after["reward"], before["reward"] - penalty * cost)
    assert torch.equal(after["reward"], before["reward"]) == (penalty == 0)
    for key in before.keys(True, True):
        if key != "reward":
            assert torch.equal(after[key], before[key]), key


def test_a_zero_penalty_leaves_the_reward_alone_even_at_an_infinite_cost():
    readings = torch.full((1, 3, 6), torch.inf)
    env = TransformedEnv(ScriptedEnv(2, wrench=readings, twist=readings), PowerLimitTransform(dt=0.01))
    steps = play(env, torch.zeros(2, 1, 2))["next"]
    assert torch.isinf(steps["cost"]).all()
    assert torch.equal(steps["reward"], torch.ones(1, 2, 1))


# -- the end of an episode ---------------------------------------------------------------------------------------------


def test_a_step_above_the_limit_terminates_its_row_only_and_one_at_the_limit_does_not():
    steps = by_hand(scripted(terminate=True))["next"]
    above = EXCESS > 0
    above[:, -1] = True  # the script ends
    assert torch.equal(steps["terminated"], above)
    assert torch.equal(steps["done"], above)


def test_an_episode_ends_at_its_first_step_above_the_limit_and_begins_anew():
    env = scripted(terminate=True)
    steps = play(env, actions_for(env, 7))["next"]
    ends = [[4, 4], [3, 3], [7]]
    for row, lengths in enumerate(ends):
        counts = [count for length in lengths for count in range(1, length + 1)][:7]
        counts += list(range(1, 8 - len(counts)))
        assert steps["count"][row].flatten().tolist() == counts
        assert steps["done"][row].flatten().tolist() == [count == lengths[0] for count in counts]
    assert torch.equal(steps["done"], steps["terminated"])


def test_an_episode_goes_on_above_the_limit_where_it_does_not_terminate():
    steps = by_hand(scripted(penalty=1.0))["next"]
    ends = (torch.arange(7) == 6).reshape(1, 7, 1).expand(3, 7, 1)
    assert torch.equal(steps["terminated"], ends)
    assert torch.equal(steps["done"], ends)


# -- under a macro step ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("discount", [1.0, 0.5])
def test_a_macro_step_sums_the_cost_of_its_control_steps(discount):
    env = scripted(MacroStepTransform(7, discount=discount), penalty=3.0)
    check_env_specs(env)
    reached = env.step(env.reset().set("action", torch.zeros(3, 7, 2, dtype=F64)))["next"]
    weights = discount ** torch.arange(7, dtype=F64).unsqueeze(-1)
    cost = (weights * 0.5 * EXCESS).sum(1)
    assert_close(reached["cost"], cost, rtol=0, atol=1e-12)
    assert_close(reached["reward"], weights.sum() - 3.0 * cost, rtol=0, atol=1e-12)
    assert reached["control_steps"].flatten().tolist() == [7, 7, 7]


def test_rows_that_the_limit_ends_inside_a_chunk_add_no_further_cost():
    env = scripted(MacroStepTransform(6), terminate=True, penalty=3.0)
    reached = env.step(env.reset().set("action", torch.zeros(3, 6, 2, dtype=F64)))["next"]
    assert reached["control_steps"].flatten().tolist() == [4, 3, 6]
    assert reached["terminated"].flatten().tolist() == [True, True, False]
    assert reached["cost"].flatten().tolist() == [0.5, 1.5, 0.0]
    assert reached["reward"].flatten().tolist() == [4 - 3 * 0.5, 3 - 3 * 1.5, 6.0]


@either_env
@pytest.mark.parametrize("mask", [None, (True, False, True)], ids=["all_rows", "masked"])
def test_rows_that_end_or_do_not_step_add_nothing_more_to_the_cost_of_a_chunk(honours, mask):
    def make(*transforms):
        base = MockArmEnv((3,), horizons=(2, 4, 9) if transforms else (20,), honours_step=honours)
        return TransformedEnv(base, Compose(PowerLimitTransform(8.0, penalty=2.0), *transforms))

    env, single = make(MacroStepTransform(5)), make()
    root, chunk = env.reset(), actions_for(env, 1)[0]
    td, costs = single.reset(), []
    for action in chunk.unbind(1):
        td = single.step(td.set("action", action))
        costs.append(td["next", "cost"])
        td = single._step_mdp(td)
    root["action"] = chunk
    executed = torch.tensor((2, 4, 5))
    if mask is not None:
        root["_step"] = torch.tensor(mask)
        executed = executed * torch.tensor(mask)
    counted = torch.arange(5) < executed.unsqueeze(-1)
    costs = torch.stack(costs, 1)
    assert (costs[~counted] > 0).any()
    reached = env.step(root)["next"]
    assert_close(reached["cost"], (costs * counted.unsqueeze(-1)).sum(1))
    assert torch.equal(reached["control_steps"].squeeze(-1), executed)


# -- errors ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("key", ["wrench", "twist"])
def test_a_missing_reading_is_a_key_error_that_names_it_and_what_there_is(key):
    td = MockArmEnv((2,)).reset().exclude(key)
    transform = PowerLimitTransform()
    for read in (transform, lambda td: transform._step(td, td), lambda td: transform._reset(td, td)):
        with pytest.raises(KeyError, match=rf"PowerLimitTransform needs .*{key}.* holds .*count"):
            read(td)


def test_an_environment_without_a_wrench_is_a_key_error_that_names_it():
    with pytest.raises(KeyError, match="wrench"):
        TransformedEnv(PendulumEnv(), PowerLimitTransform(dt=0.05)).rollout(1)


@pytest.mark.parametrize("value", [-1.0, 0.0, float("nan"), float("inf")])
def test_a_control_step_that_is_not_positive_is_refused_by_name(value):
    with pytest.raises(ValueError, match=rf"dt is {value}; expected a finite number above 0"):
        PowerLimitTransform(dt=value)


@pytest.mark.parametrize("name", ["p_max", "penalty"])
@pytest.mark.parametrize("value", [-1e-3, float("nan"), float("inf")])
def test_a_number_that_is_negative_or_not_finite_is_refused_by_name(name, value):
    with pytest.raises(ValueError, match=rf"{name} is {value}; expected a finite number of at least 0"):
        PowerLimitTransform(**{name: value})


# -- another power -----------------------------------------------------------------------------------------------------


def test_a_limit_of_zero_makes_the_whole_work_the_cost():
    steps = by_hand(scripted())["next"]
    whole = TransformedEnv(scripted().base_env, PowerLimitTransform(0.0, dt=0.5))
    assert torch.equal(by_hand(whole)["next", "cost"], 0.5 * POWER[:, 1:].abs().unsqueeze(-1).expand_as(steps["cost"]))


def test_a_given_power_is_the_one_that_counts():
    td = TensorDict({"power": torch.tensor([[3.0], [-5.0], [1.0]]), "wrench": torch.ones(3, 6)}, [3])
    assert PowerLimitTransform(2.0, power_key="power", dt=0.5)(td)["cost"].flatten().tolist() == [0.5, 1.5, 0.0]


def test_a_power_that_is_not_there_is_a_key_error_that_names_it():
    with pytest.raises(KeyError, match=r"PowerLimitTransform needs \['power'\]"):
        PowerLimitTransform(power_key="power")(TensorDict({"wrench": torch.ones(3, 6)}, [3]))


# -- the simulated arm -------------------------------------------------------------------------------------------------


def test_the_cost_on_the_simulated_arm_is_that_of_its_measured_wrench_and_twist():
    limit = PowerLimitTransform(0.5, penalty=10.0, terminate=False)
    env = push_env(4, limit, duration=0.2, engine=COARSE)
    steps = play(env, actions_for(env, 20, scale=10.0))["next"]
    cost = steps["cost"]
    assert 0 < (cost > 0).sum() < cost.numel()
    assert_close(cost.double(), measured_cost(steps, 0.5), rtol=1e-5, atol=1e-6)
    terms = sum(steps["reward_terms"].values())
    assert_close(steps["reward"], terms - 10.0 * cost, rtol=0, atol=1e-5)


def test_specs_hold_on_the_simulated_arm_that_ends_above_the_limit():
    env = push_env(4, PowerLimitTransform(0.5, terminate=True), duration=0.5, engine=COARSE)
    check_env_specs(env)
    steps = play(env, actions_for(env, 20, scale=10.0))["next"]
    assert 0 < steps["terminated"].sum() < steps["terminated"].numel()
    assert torch.equal(steps["terminated"], steps["cost"] > 0)
    assert torch.equal(steps["terminated"], steps["done"])
