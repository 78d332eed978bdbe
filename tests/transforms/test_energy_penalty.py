"""The penalty on energy from the tank: what it adds up to, where it may stand, and what it cannot be fooled by."""

from __future__ import annotations

import pytest
import torch
from torchrl.envs import Compose, TransformedEnv

from ppt_rl.transforms import EnergyPenaltyTransform, EnergyTankTransform, MacroStepTransform
from tests.transforms.mocks import MockArmEnv

WEIGHT = 3.0


def env(*after: object, penalty: bool = True, **kwargs: object) -> TransformedEnv:
    """A mock arm behind a tank that drains, with the penalty or without."""
    parts = [EnergyTankTransform(p_max=1.0, e_max=0.02)]
    parts += [EnergyPenaltyTransform(WEIGHT, **kwargs)] if penalty else []
    return TransformedEnv(MockArmEnv((2,), horizons=(20,)), Compose(*parts, *after))


def rollout(world: TransformedEnv, steps: int, seed: int = 4) -> object:
    """The same actions in the same episode for everyone."""
    torch.manual_seed(seed)
    world.set_seed(seed)
    return world.rollout(steps)


def test_an_episode_pays_the_weight_times_the_energy_that_it_spent():
    free, paid = rollout(env(penalty=False), 8), rollout(env(), 8)
    spent = paid["tank_energy"][:, 0] - paid["next", "tank_energy"][:, -1]
    assert (spent > 1e-3).all()
    lost = (free["next", "reward"] - paid["next", "reward"]).sum(-2)
    torch.testing.assert_close(lost, WEIGHT * spent, rtol=1e-4, atol=1e-6)


def test_a_weight_of_zero_leaves_the_reward_alone():
    free = rollout(env(penalty=False), 5)
    zero = TransformedEnv(
        MockArmEnv((2,), horizons=(20,)), Compose(EnergyTankTransform(1.0, 0.02), EnergyPenaltyTransform(0.0))
    )
    torch.testing.assert_close(rollout(zero, 5)["next", "reward"], free["next", "reward"], rtol=0, atol=0)


def test_a_macro_step_sums_what_its_control_steps_pay():
    flat, chunks = env(), env(MacroStepTransform(4))
    actions = torch.randn(2, 8, 7, generator=torch.Generator().manual_seed(3))
    for world in (flat, chunks):
        world.set_seed(4)
    td, rewards = flat.reset(), []
    for step in range(8):
        td, following = flat.step_and_maybe_reset(td.set("action", actions[:, step]))
        rewards.append(td["next", "reward"])
        td = following
    td, summed = chunks.reset(), []
    for step in (0, 4):
        td, following = chunks.step_and_maybe_reset(td.set("action", actions[:, step : step + 4]))
        summed.append(td["next", "reward"])
        td = following
    torch.testing.assert_close(torch.stack(rewards).unflatten(0, (2, 4)).sum(1), torch.stack(summed))


def test_after_a_macro_step_it_is_refused():
    parts = [EnergyTankTransform(1.0, 0.02), MacroStepTransform(4), EnergyPenaltyTransform()]
    with pytest.raises(ValueError, match="stands after a MacroStepTransform"):
        TransformedEnv(MockArmEnv((2,)), Compose(*parts)).reset()


def test_a_policy_that_lowers_the_level_pays_for_what_it_threw_away():
    base = MockArmEnv((2,), horizons=(20,))
    base.state_in_tensordict = False  # as a simulator, which is one moment further after each step
    world = TransformedEnv(base, Compose(EnergyTankTransform(1.0, 0.02), EnergyPenaltyTransform(WEIGHT)))
    free = TransformedEnv(MockArmEnv((2,), horizons=(20,)), EnergyTankTransform(1.0, 0.02))
    rewards = []
    for each in (world, free):
        each.set_seed(4)
        td = each.reset()
        td["action"] = torch.zeros(2, 7)  # the tank itself spends nothing
        td["tank_energy"] = 0.5 * td["tank_energy"]
        rewards.append(each.step(td)["next", "reward"])
    torch.testing.assert_close(rewards[1] - rewards[0], torch.full((2, 1), WEIGHT * 0.01))


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"energy_key": "absent"}, r"needs 'absent'.*EnergyTankTransform"),
        ({"reward_key": "bonus"}, r"needs 'bonus'.*'reward'"),
    ],
)
def test_a_missing_key_is_named_before_the_first_reset(kwargs, message):
    with pytest.raises(KeyError, match=message):
        _ = env(**kwargs).full_observation_spec


def test_without_a_tank_the_error_says_what_to_append():
    with pytest.raises(KeyError, match="Append an EnergyTankTransform before it"):
        TransformedEnv(MockArmEnv(), EnergyPenaltyTransform()).reset()
