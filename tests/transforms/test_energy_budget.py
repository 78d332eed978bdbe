"""The budget that a policy asks for: what is granted, charged once, and what no policy can do about it."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import Compose, EnvBase, TransformedEnv
from torchrl.envs.utils import check_env_specs

from ppt_rl.transforms import EnergyBudgetTransform, EnergyTankTransform, HoldActionTransform, MacroStepTransform
from tests.transforms.mocks import AgentsEnv, MockArmEnv, NestedEffortEnv

E_MAX, WEIGHT, STEPS = 0.05, 3.0, 20


def env(*between: object, weight: float = WEIGHT, simulator: bool = False, batch=(3,), **kwargs) -> TransformedEnv:
    """A mock arm behind a tank that grants what is asked for; as a simulator it keeps its state inside."""
    base = MockArmEnv(batch, horizons=(STEPS,))
    base.state_in_tensordict = not simulator
    tank = EnergyTankTransform(2.0, E_MAX, e_max_key="e_max")
    return TransformedEnv(base, Compose(tank, *between, EnergyBudgetTransform(E_MAX, weight=weight, **kwargs)))


def asking(world: TransformedEnv, requests: list[float], push: float = 30.0) -> torch.Tensor:
    """An action that pushes hard and asks for energy, by row."""
    action = torch.full(world.full_action_spec["action"].shape, push)
    action[..., -1] = torch.tensor(requests).reshape(-1, *[1] * (action.ndim - 2))
    return action


def spend(world: TransformedEnv, requests: list[list[float]]) -> list[TensorDictBase]:
    """Steps of one episode, with the requests of each."""
    world.set_seed(4)
    td, steps = world.reset(), []
    for request in requests:
        steps.append(world.step(td.set("action", asking(world, request))))
        td = world._step_mdp(steps[-1])
    return steps


# -- what is granted ---------------------------------------------------------------------------------------------------


@given(st.floats(width=32, allow_nan=False), st.floats(0.01, 0.99), st.floats(0.01, 0.99), st.floats(0.01, 100.0))
def test_whatever_is_asked_for_lies_between_the_least_share_and_the_hard_bound(request_, least, initial, e_max):
    budget = EnergyBudgetTransform(e_max, least_share=least, initial_share=initial)
    granted = budget.granted(torch.tensor([request_], dtype=torch.float32))
    most = torch.tensor([e_max], dtype=torch.float32)
    assert bool((granted <= most).all())
    assert bool((granted >= least * most * (1 - 1e-6)).all())
    assert bool((granted > 0).all())


def test_a_request_of_zero_has_the_initial_share_of_the_range_and_more_is_granted_to_more():
    budget = EnergyBudgetTransform(2.0, least_share=0.25, initial_share=0.6)
    assert float(budget.granted(torch.zeros(1))) == pytest.approx(2.0 * (0.25 + 0.75 * 0.6))
    granted = budget.granted(torch.linspace(-4, 4, 50, dtype=torch.float64))
    assert bool((granted.diff() > 0).all())
    one = 2.0 * (0.25 + 0.75 / (1 + math.exp(-1.0) * 0.4 / 0.6))
    assert float(budget.granted(torch.ones(1, dtype=torch.float64))) == pytest.approx(one)


def test_the_tank_holds_what_was_granted_and_the_action_arrives_without_the_request():
    world = env()
    check_env_specs(world)
    (step,) = spend(world, [[-50.0, 0.0, 50.0]])
    granted = step["next", "energy_budget"]
    torch.testing.assert_close(granted.flatten(), E_MAX * torch.tensor([0.1, 0.1 + 0.9 * 0.8, 1.0]))
    assert torch.equal(step["next", "e_max"], granted)
    assert step["action"].shape == (3, 8)
    assert step["next", "executed"].shape == (3, 7)
    assert (world.reset()["energy_budget"] == 0).all()


# -- once an episode ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("in_chunks", [False, True])
def test_an_episode_pays_for_its_budget_once_and_cannot_change_it(in_chunks):
    def play(weight: float) -> list[TensorDictBase]:
        between = [MacroStepTransform(2), HoldActionTransform(2)] if in_chunks else []
        return spend(env(*between, weight=weight), [[1.0, -2.0, 0.0], [9.0, 9.0, -9.0], [-9.0, 0.0, 9.0]])

    free, paid = play(0.0), play(WEIGHT)
    granted = EnergyBudgetTransform(E_MAX).granted(torch.tensor([[1.0], [-2.0], [0.0]]))
    for step in paid:
        torch.testing.assert_close(step["next", "energy_budget"], granted)
        torch.testing.assert_close(step["next", "e_max"], granted)
    lost = [one["next", "reward"] - other["next", "reward"] for one, other in zip(free, paid, strict=True)]
    torch.testing.assert_close(lost[0], WEIGHT * granted, rtol=1e-4, atol=1e-6)
    assert not torch.stack(lost[1:]).any()


def test_a_partial_reset_grants_anew_in_its_rows_only():
    world = env(simulator=True)
    (step,) = spend(world, [[2.0, 2.0, 2.0]])
    granted = step["next", "energy_budget"]
    td = world._step_mdp(step)
    td = world.reset(td.set("_reset", torch.tensor([[True], [False], [False]])))
    assert torch.equal(td["energy_budget"], torch.cat([torch.zeros(1, 1), granted[1:]]))
    after = world.step(td.set("action", asking(world, [-2.0, -2.0, -2.0])))["next"]
    assert float(after["energy_budget"][0]) == pytest.approx(float(world.transform[-1].granted(torch.tensor(-2.0))))
    assert torch.equal(after["energy_budget"][1:], granted[1:])


def test_a_row_that_does_not_step_is_granted_nothing_and_pays_nothing():
    world = env()
    td = world.reset().set("action", asking(world, [0.0, 0.0, 0.0]))
    after = world.step(td.set("_step", torch.tensor([True, False, True])))["next"]
    assert float(after["energy_budget"][1]) == 0.0
    assert float(after["e_max"][1]) == pytest.approx(E_MAX)
    assert float(after["reward"][1]) == 0.0
    assert (after["energy_budget"][[0, 2]] > 0).all()


# -- attacks -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_no_policy_gets_more_than_it_was_granted_whatever_it_asks_for_or_writes(seed):
    world = env(simulator=True)
    generator = torch.Generator().manual_seed(seed)
    world.set_seed(seed)
    td, work, granted = world.reset(), torch.zeros(3, 1), None
    for step in range(STEPS - 1):
        flow = td["joint_velocity"].clone()
        action = 1e3 * torch.randn(3, 8, generator=generator)
        if step % 3 == 1:
            action[..., -1] = 1e30
        for key in ("e_max", "energy_budget"):
            if step % 2:  # what a policy may write: anything
                td[key] = 1e6 * torch.rand(3, 1, generator=generator) * (step % 4 - 2)
        after = world.step(td.set("action", action))["next"]
        granted = after["energy_budget"].clone() if granted is None else granted
        assert torch.equal(after["energy_budget"], granted)
        assert torch.equal(after["e_max"], granted)
        work += 0.01 * (after["executed"] * flow).sum(-1, keepdim=True).abs()
        assert (work <= granted * (1 + 1e-6)).all()
        td = world._step_mdp(td.set("next", after))
    assert (granted <= E_MAX).all()
    assert (work > 0.5 * granted).any()  # the attack did push


def test_the_tanks_own_bound_holds_where_the_budget_is_made_too_large():
    tank = EnergyTankTransform(2.0, E_MAX, e_max_key="e_max")
    world = TransformedEnv(MockArmEnv((3,), horizons=(STEPS,)), Compose(tank, EnergyBudgetTransform(100 * E_MAX)))
    steps = spend(world, [[50.0] * 3] * 8)
    assert (steps[0]["next", "energy_budget"] > 90 * E_MAX).all()
    assert torch.equal(steps[0]["next", "e_max"], torch.full((3, 1), E_MAX))
    flows = [step["joint_velocity"] for step in steps]
    work = sum(0.01 * (s["next", "executed"] * f).sum(-1).abs() for s, f in zip(steps, flows, strict=True))
    assert (work <= E_MAX * (1 + 1e-6)).all()


# -- errors ------------------------------------------------------------------------------------------------------------


def test_without_a_tank_that_reads_the_budget_the_error_says_what_to_append():
    for parts in ([], [EnergyTankTransform(1.0, 1.0)]):
        world = TransformedEnv(MockArmEnv((2,)), Compose(*parts, EnergyBudgetTransform(1.0)))
        with pytest.raises(KeyError, match=r"needs 'e_max'.*Append it after an EnergyTankTransform\(e_max_key"):
            world.reset()


def test_an_action_with_nothing_but_the_request_or_of_another_kind_is_refused():
    budget = EnergyBudgetTransform(1.0)
    with pytest.raises(ValueError, match=r"has shape \(2, 1\); expected \(\*B, A \+ 1\)"):
        budget.inv(TensorDict({"action": torch.zeros(2, 1)}, [2]))
    with pytest.raises(ValueError, match=r"with a request.*finite"):
        budget.inv(TensorDict({"action": torch.full((2, 3), torch.nan)}, [2]))


def agents_behind_tanks(base: EnvBase, nest: str, **keys: object) -> TransformedEnv:
    """Agents in a nest, a tank for each, that ask for budgets."""
    named = {name: (nest, name) for name in ("action", "twist", "e_max", "tank_energy", "valve")}
    tank = EnergyTankTransform(
        1.0, 1.0, effort_key=named["action"], flow_key=named["twist"], e_max_key=named["e_max"],
        out_keys=(named["tank_energy"], named["valve"]),
    )  # fmt: skip
    budget = EnergyBudgetTransform(1.0, limit_key=named["e_max"], action_key=named["action"], **keys)
    return TransformedEnv(base, Compose(tank, budget))


def test_every_agent_has_a_budget_and_a_reward_of_its_own():
    world = agents_behind_tanks(AgentsEnv(), "agents", reward_key=("agents", "reward"))
    action = torch.zeros(3, 2, 7)
    action[:, 1, -1] = 50.0
    after = world.step(world.reset().set(("agents", "action"), action))["next"]
    torch.testing.assert_close(after["energy_budget"], torch.tensor([[0.82], [1.0]]).expand(3, 2, 1))
    assert torch.equal(after["agents", "e_max"], after["energy_budget"])


def test_a_reward_of_another_shape_than_the_budget_is_refused_and_so_is_a_missing_one():
    with pytest.raises(
        ValueError, match=r"reward 'reward' has shape \(3, 1\), the budget \(3, 2, 1\); expected the same"
    ):
        agents_behind_tanks(NestedEffortEnv((3,), (2,)), "agent").reset()
    with pytest.raises(KeyError, match="needs 'reward'"):
        agents_behind_tanks(AgentsEnv(), "agents").reset()
