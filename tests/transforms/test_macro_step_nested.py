"""Chunks of an action that lies in a nest, as multi-agent environments have it."""

from __future__ import annotations

import pytest
import torch
from torchrl.data import Composite, Unbounded
from torchrl.envs import Compose, TransformedEnv
from torchrl.envs.utils import check_env_specs

from ppt_rl.transforms import EnergyTankTransform, MacroStepTransform
from tests.transforms.mocks import AgentsEnv, MockArmEnv

KEY = ("agents", "action")
either_done = pytest.mark.parametrize("nested_done", [False, True], ids=["root done", "nested done"])


def make_env(num_steps=4, batch=(3,), *inner, **kwargs):
    options = {"horizons": (6, 2, 9), **kwargs}
    trace = options.pop("trace_keys", ())
    discount = options.pop("discount", 1.0)
    macro = MacroStepTransform(num_steps, action_key=KEY, trace_keys=trace, discount=discount)
    return TransformedEnv(AgentsEnv(batch, **options), Compose(*inner, macro))


def chunk_for(env, seed=0):
    spec = env.full_action_spec[KEY]
    return torch.randn(spec.shape, generator=torch.Generator().manual_seed(seed))


def by_hand(env, root, chunk, executed):
    """The control steps of one row after another, without regard to done."""
    td, steps = root.clone(), []
    for k in range(executed):
        td = env.base_env.step(td.set(KEY, chunk.select(env.batch_dims + 1, k)))
        steps.append(td["next"].clone())
        td = env.base_env._step_mdp(td)
    return steps


@either_done
@pytest.mark.parametrize("batch", [(), (3,), (2, 3)], ids=str)
def test_specs_hold_and_the_chunk_follows_the_batch_of_the_nest(batch, nested_done):
    env = make_env(4, batch, nested_done=nested_done)
    check_env_specs(env, break_when_any_done="both")
    assert env.full_action_spec[KEY].shape == (*batch, 2, 4, 6)
    assert env.full_action_spec["agents"].shape == (*batch, 2)


@either_done
@pytest.mark.parametrize("discount", [1.0, 0.9])
def test_the_rewards_of_the_agents_are_summed_until_the_row_ends(nested_done, discount):
    env = make_env(nested_done=nested_done, discount=discount, trace_keys=[("agents", "executed")])
    root, chunk = env.reset(), chunk_for(env)
    reached = env.step(root.clone().set(KEY, chunk))["next"]
    assert reached["control_steps"].flatten().tolist() == [4, 2, 4]
    steps = by_hand(env, root, chunk, 4)
    for row, executed in enumerate((4, 2, 4)):
        rewards = torch.stack([discount**k * steps[k]["agents", "reward"][row] for k in range(executed)])
        torch.testing.assert_close(reached["agents", "reward"][row], rewards.sum(0))
        for key in (("agents", "twist"), ("agents", "executed"), ("agents", "count")):
            torch.testing.assert_close(reached[key][row], steps[executed - 1][key][row], rtol=0, atol=0)
        trace = reached["trace", "agents", "executed"][row]
        torch.testing.assert_close(trace[:executed], chunk[row, :, :executed].transpose(0, 1), rtol=0, atol=0)
        assert not trace[executed:].any()


@either_done
def test_the_rows_that_ended_are_reset_and_the_others_go_on(nested_done):
    env = make_env(nested_done=nested_done)
    steps = env.rollout(3, break_when_any_done=False)["next"]
    done = steps["agents", "done"].any(-2) if nested_done else steps["done"]
    assert done.squeeze(-1).tolist() == [[False, True, False], [True, True, True], [False, False, True]]
    assert steps["control_steps"].squeeze(-1).tolist() == [[4, 2, 4], [2, 2, 2], [4, 4, 1]]


def test_a_tank_of_each_agent_works_at_control_rate_inside_the_chunk():
    tank = EnergyTankTransform(0.5, 0.01, effort_key=KEY, flow_key=("agents", "twist"), out_keys=("level", "valve"))
    env = make_env(4, (3,), tank, trace_keys=["level"])
    check_env_specs(env)
    root = env.reset()
    assert root["level"].shape == (3, 2, 1)
    levels = env.step(root.set(KEY, 5 * chunk_for(env)))["next", "trace", "level"]
    assert levels.shape == (3, 4, 2, 1)
    assert (levels.diff(dim=1)[0] <= 0).all()
    assert levels[0, -1].max() < 0.01


def test_a_chunk_of_another_length_is_refused_with_the_expected_shape():
    env = make_env()
    with pytest.raises(ValueError, match=r"action has shape \(3, 2, 5, 6\); expected a chunk \(3, 2, 4, A\)"):
        env.step(env.reset().set(KEY, torch.zeros(3, 2, 5, 6)))


def test_a_second_action_is_refused_because_nothing_says_what_it_does_during_the_chunk():
    base = MockArmEnv((2,))
    both = Composite(action=base.action_spec, grip=Unbounded(shape=(2, 1)), shape=(2,))
    base.action_spec = both
    with pytest.raises(ValueError, match=r"chunks of 'action' alone; expected no \['grip'\]"):
        TransformedEnv(base, MacroStepTransform(3)).reset()
