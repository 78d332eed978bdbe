from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import Compose, PendulumEnv, SerialEnv, TransformedEnv
from torchrl.envs.utils import check_env_specs

from ppt_rl.transforms import EpisodeMetricsTransform, MacroStepTransform
from tests.transforms.cases import control_chain, make_chain_env, make_promp_transform, push_env
from tests.transforms.mocks import MockArmEnv, actions_for, play

either_env = pytest.mark.parametrize("honours", [True, False], ids=["honours_step", "ignores_step"])


def make_env(num_steps, horizons, honours=True, batch=(3,), **kwargs):
    base = MockArmEnv(batch, horizons=horizons, honours_step=honours)
    return TransformedEnv(base, MacroStepTransform(num_steps, **kwargs))


def by_hand(base, root, chunk):
    """Control steps ``(*B, N)`` of a chunk, one by one, without regard to done."""
    td, steps = root.clone(), []
    for action in chunk.unbind(1):
        td = base.step(td.set("action", action))
        steps.append(td["next"].clone())
        td = base._step_mdp(td)
    return torch.stack(steps, 1)


@pytest.mark.parametrize("discount", [1.0, 0.9])
def test_rewards_and_reward_terms_are_the_discounted_sum_of_the_control_steps(discount):
    env = make_env(4, (20,), discount=discount)
    root, chunk = env.reset(), actions_for(env, 1)[0]
    steps = by_hand(env.base_env, root, chunk)
    reached = env.step(root.clone().set("action", chunk))["next"]
    weights = discount ** torch.arange(4.0).reshape(1, 4, 1)
    for key in ("reward", ("reward_terms", "near"), ("reward_terms", "far")):
        torch.testing.assert_close(reached[key], (weights * steps[key]).sum(1))
    torch.testing.assert_close(reached["reward"], reached["reward_terms", "near"] + reached["reward_terms", "far"])


def test_the_other_entries_are_those_of_the_last_control_step():
    env = make_env(4, (20,))
    root, chunk = env.reset(), actions_for(env, 1)[0]
    last = by_hand(env.base_env, root, chunk)[:, -1]
    reached = env.step(root.clone().set("action", chunk))["next"]
    for key in last.keys(True, True):
        if key != "reward" and key[0] != "reward_terms":
            torch.testing.assert_close(reached[key], last[key], rtol=0, atol=0)


def test_a_chunk_on_the_simulated_arm_equals_stepping_the_inner_environment_by_hand():
    inner = push_env(2, *control_chain(), seed=4)
    outer = push_env(2, *control_chain(), MacroStepTransform(5, discount=0.9), seed=4)
    generator = torch.Generator().manual_seed(2)
    hand, macro = inner.reset(), outer.reset()
    for _ in range(2):  # two chunks of five: a whole episode
        pose = hand["pose"].clone()
        pose[:, :2] += 0.02 * torch.rand(2, 2, generator=generator)
        reference = torch.cat([pose, torch.zeros(2, 6)], -1).unsqueeze(1) + 1e-3 * torch.randn(
            2, 5, 13, generator=generator
        )
        reward = torch.zeros(2, 1)
        for k in range(5):
            hand = inner.step(hand.set("action", reference[:, k]))
            reward = reward + 0.9**k * hand["next", "reward"]
            last, hand = hand["next"].clone(), inner._step_mdp(hand)
        macro = outer.step(macro.set("action", reference))
        for key in last.keys(True, True):
            if key != "reward" and key[0] != "reward_terms":
                torch.testing.assert_close(macro["next", key], last[key], rtol=0, atol=0)
        torch.testing.assert_close(macro["next", "reward"], reward, rtol=1e-6, atol=1e-6)
        macro = outer._step_mdp(macro)
    assert last["done"].all()
    assert (last["metrics", "max_power_measured"] > 0).all()


@either_env
def test_rows_that_end_inside_a_chunk_are_frozen_at_their_last_control_step(honours):
    env = make_env(5, (2, 4, 9), honours, discount=0.9, trace_keys=["executed", "count"])
    root, chunk = env.reset(), actions_for(env, 1)[0]
    steps = by_hand(MockArmEnv((3,), horizons=(20,)), root, chunk)
    reached = env.step(root.clone().set("action", chunk))["next"]
    assert reached["control_steps"].flatten().tolist() == [2, 4, 5]
    assert reached["done"].flatten().tolist() == [True, True, False]
    for row, executed in enumerate((2, 4, 5)):
        weights = 0.9 ** torch.arange(float(executed)).unsqueeze(-1)
        for key in ("reward", ("reward_terms", "near"), ("reward_terms", "far")):
            torch.testing.assert_close(reached[key][row], (weights * steps[key][row, :executed]).sum(0))
        for key in ("count", "push", "executed", "pose", "twist", "joint_velocity"):
            torch.testing.assert_close(reached[key][row], steps[key][row, executed - 1], rtol=0, atol=0)
        for key in ("executed", "count"):
            trace = reached["trace", key][row]
            assert torch.equal(trace[:executed], steps[key][row, :executed])
            assert not trace[executed:].any()


@either_env
def test_when_every_row_ends_early_all_are_frozen_and_the_remaining_actions_do_nothing(honours):
    env = make_env(6, (1, 3, 2), honours, trace_keys=["count"])
    root, chunk = env.reset(), actions_for(env, 1)[0]
    steps = by_hand(MockArmEnv((3,), horizons=(20,)), root, chunk)
    reached = env.step(root.clone().set("action", chunk))["next"]
    assert reached["control_steps"].flatten().tolist() == [1, 3, 2]
    assert reached["done"].all()
    assert reached["trace", "count"].shape == (3, 6, 1)
    assert reached["trace", "count"].squeeze(-1).tolist() == [
        [1, 0, 0, 0, 0, 0],
        [1, 2, 3, 0, 0, 0],
        [1, 2, 0, 0, 0, 0],
    ]
    for row, executed in enumerate((1, 3, 2)):
        torch.testing.assert_close(reached["push"][row], steps["push"][row, executed - 1], rtol=0, atol=0)
        torch.testing.assert_close(reached["reward"][row], steps["reward"][row, :executed].sum(0))


@either_env
def test_the_metrics_of_a_row_that_ends_early_are_those_of_its_own_episode(honours):
    def metrics(horizons, chunk_length):
        base = MockArmEnv((2,), horizons=horizons, honours_step=honours)
        env = TransformedEnv(base, Compose(EpisodeMetricsTransform(), MacroStepTransform(chunk_length)))
        chunk = torch.arange(float(2 * 6 * 7)).reshape(2, 6, 7).cos()[:, :chunk_length]
        return env.step(env.reset().set("action", chunk))["next"]

    early = metrics((3, 6), 6)
    for key in ("metrics", "metrics_memory"):
        expected = metrics((3, 3), 3)[key][0]
        assert (early[key][0] == expected).all()


@either_env
def test_control_steps_add_up_to_the_length_of_every_episode(honours):
    env = make_env(3, (7, 5, 6), honours)
    steps = play(env, actions_for(env, 3))["next"]
    counted = steps["control_steps"].squeeze(-1)
    for row, horizon in enumerate((7, 5, 6)):
        ends = int(steps["done"][row].flatten().nonzero()[0])
        assert counted[row, : ends + 1].sum() == horizon
    assert counted.dtype == torch.int64


def test_the_simulated_arm_freezes_all_rows_at_a_horizon_inside_a_chunk_and_can_be_reset():
    env = make_chain_env(replan_steps=4)  # a horizon of ten control steps
    steps = play(env, actions_for(env, 6))["next"]
    assert steps["control_steps"][0].flatten().tolist() == [4, 4, 2] * 2
    assert steps["done"][0].flatten().tolist() == [False, False, True] * 2
    assert not steps["trace", "power"][:, [2, 5], 2:].any()


def test_rows_outside_the_callers_step_mask_count_no_control_steps_and_earn_nothing():
    env = make_env(4, (2, 9, 9))
    td = env.reset().set("action", actions_for(env, 1)[0])
    full = env.step(td.clone())["next"]
    masked = env.step(td.clone().set("_step", torch.tensor([True, True, False])))["next"]
    assert masked["control_steps"].flatten().tolist() == [2, 4, 0]
    assert masked["reward"][2] == 0
    assert masked["count"][2] == 0
    for key in ("reward", "count", "push", "done", "pose"):
        assert torch.equal(masked[key][:2], full[key][:2])


def test_a_rollout_until_all_rows_are_done_steps_every_row_to_its_own_end_and_no_further():
    env = make_env(2, (3, 8, 5))
    steps = env.rollout(10, break_when_all_done=True)["next"]
    assert steps.shape == (3, 4)
    assert steps["count"][:, -1].flatten().tolist() == [3.0, 8.0, 5.0]
    for row, horizon in enumerate((3, 8, 5)):
        ends = int(steps["done"][row].flatten().nonzero()[0])
        assert steps["control_steps"][row, : ends + 1].sum() == horizon


def test_a_transformed_serial_env_freezes_the_workers_that_end_inside_a_chunk():
    makers = [lambda h=h: MockArmEnv((1,), horizons=(h,)) for h in (2, 5)]
    serial = TransformedEnv(SerialEnv(2, makers), MacroStepTransform(4, trace_keys=["count"]))
    reached = serial.step(serial.reset().set("action", actions_for(serial, 1)[0]))["next"]
    assert reached["control_steps"].flatten().tolist() == [2, 4]
    assert reached["count"].flatten().tolist() == [2.0, 4.0]
    assert reached["trace", "count"].flatten().tolist() == [1.0, 2.0, 0.0, 0.0, 1.0, 2.0, 3.0, 4.0]


def test_a_clone_sums_the_reward_terms_of_the_environment_that_it_moves_to():
    first = TransformedEnv(MockArmEnv((2,), reward_terms=False), MacroStepTransform(2))
    play(first, actions_for(first, 1))
    second = TransformedEnv(MockArmEnv((2,)), first.transform.clone())
    terms = play(second, actions_for(second, 1))["next"]
    total = terms["reward_terms", "near"] + terms["reward_terms", "far"]
    torch.testing.assert_close(terms["reward"], total)


def test_without_a_number_of_steps_the_length_is_the_one_of_the_transform_that_makes_the_chunk():
    base = MockArmEnv((2,), action_shape=(13,), horizons=(20,))
    env = TransformedEnv(base, Compose(MacroStepTransform(), make_promp_transform()))
    check_env_specs(env)
    assert play(env, actions_for(env, 2))["next", "control_steps"].flatten().tolist() == [5, 5, 5, 5]


# -- errors ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [(3, 0, 7), (3, 7), (3, 3, 7), (3, 5, 7)])
def test_a_chunk_of_another_length_is_refused_with_both_shapes(shape):
    env = make_env(4, (20,))
    with pytest.raises(ValueError, match=r"action has shape .*expected a chunk \(3, 4, A\)"):
        env.step(env.reset().set("action", torch.zeros(shape)))


@pytest.mark.parametrize("shape", [(3, 0, 7), (3, 7)])
def test_an_empty_chunk_is_refused_when_any_length_is_allowed(shape):
    env = make_env(None, (20,))
    with pytest.raises(ValueError, match="at least one action"):
        env.step(env.reset().set("action", torch.zeros(shape)))


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_a_chunk_that_is_not_finite_is_refused_before_any_control_step(bad):
    env = make_env(4, (20,))
    chunk = torch.zeros(3, 4, 7)
    chunk[1, 3, 2] = bad
    stepped = []
    env.base_env._step = lambda td: stepped.append(td)
    with pytest.raises(ValueError, match=r"action \(chunk\) holds 1 NaN or infinite"):
        env.step(env.reset().set("action", chunk))
    assert stepped == []


def test_without_an_environment_it_says_where_to_append_it():
    td = MockArmEnv((3,)).reset().set("action", torch.zeros(3, 4, 7))
    with pytest.raises(RuntimeError, match="append it to a TransformedEnv"):
        MacroStepTransform(4).inv(td)


@pytest.mark.parametrize("num_steps", [0, -1])
def test_a_number_of_steps_below_one_is_refused(num_steps):
    with pytest.raises(ValueError, match="num_steps"):
        MacroStepTransform(num_steps)


@pytest.mark.parametrize("discount", [0.0, -0.5, 1.5, float("nan")])
def test_a_discount_outside_zero_to_one_is_refused(discount):
    with pytest.raises(ValueError, match="discount"):
        MacroStepTransform(4, discount=discount)


def test_an_unknown_trace_key_is_refused_with_the_observations_that_there_are():
    with pytest.raises(ValueError, match=r"'absent'.* is no observation.*joint_velocity"):
        make_env(4, (20,), trace_keys=["absent"]).reset()


def test_trace_keys_without_a_number_of_steps_are_refused():
    with pytest.raises(ValueError, match="trace_keys need num_steps"):
        make_env(None, (20,), trace_keys=["count"]).reset()


@pytest.mark.parametrize("batch", [(3,), (2, 3)], ids=str)
def test_an_environment_without_a_batch_lock_runs_chunks_in_any_batch(batch):
    env = TransformedEnv(PendulumEnv(), MacroStepTransform(4, trace_keys=["th"]))
    td = env.reset(TensorDict(batch_size=batch))
    assert td["trace", "th"].shape == (*batch, 4)
    chunk = torch.randn(*batch, 4, 1)
    reached = env.step(td.clone().set("action", chunk))["next"]
    for action in chunk.unbind(len(batch)):
        td = env.base_env.step(td.set("action", action))["next"]
    torch.testing.assert_close(reached["th"], td["th"])
    assert (reached["control_steps"] == 4).all()
