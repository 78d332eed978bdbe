from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from ppt_rl.modules import make_actor, make_critic
from ppt_rl.training.ppo import PPOConfig, _Learner


def batch(actor, count=256):
    """A contextual bandit: the best action is the observation itself."""
    with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
        data = actor(TensorDict({"observation": torch.randn(count, 2)}, [count]))
    reward = -(data["action"] - data["observation"]).square().sum(-1, keepdim=True)
    done = torch.ones_like(reward, dtype=torch.bool)
    following = {
        "observation": torch.randn(count, 2), "reward": reward, "done": done, "terminated": done,
        "truncated": ~done, "control_steps": torch.full_like(reward, 10, dtype=torch.int64),
    }  # fmt: skip
    data["next"] = TensorDict(following, [count])
    return data.unsqueeze(1).refine_names(None, "time")


def learner(**settings):
    actor = make_actor(["observation"], 2, 2, initial_scale=0.5)
    return _Learner(actor, make_critic(["observation"], 2), PPOConfig(**settings))


def test_ppo_improves_the_reward_of_a_contextual_bandit():
    ppo = learner(target_kl=0.05)
    rewards = []
    for _ in range(25):
        data = batch(ppo.actor)
        rewards.append(float(data["next", "reward"].mean()))
        ppo.update(data)
    assert sum(rewards[-5:]) / 5 > 0.7 * rewards[0]


def test_values_are_not_bootstrapped_past_the_end_of_a_task():
    ppo = learner()
    data = batch(ppo.actor)
    ppo.advantage(data)
    torch.testing.assert_close(data["value_target"], data["next", "reward"])


def test_the_discount_counts_control_steps():
    ppo = learner(gamma=0.9)
    data = batch(ppo.actor)
    data["next", "terminated"] = torch.zeros_like(data["next", "terminated"])
    ppo.advantage(data)
    expected = data["next", "reward"] + 0.9**10 * data["next", "state_value"]
    torch.testing.assert_close(data["value_target"], expected)


def test_the_divergence_is_zero_before_an_update_and_positive_after():
    ppo = learner()
    data = batch(ppo.actor).reshape(-1)
    assert float(ppo._divergence(data)) == pytest.approx(0.0, abs=1e-6)
    assert ppo.update(batch(ppo.actor))["kl"] > 0


@pytest.mark.parametrize(("name", "value"), [("epochs", 0), ("clip", -0.1), ("gamma", 1.5), ("learning_rate", -1.0)])
def test_impossible_settings_are_refused(name, value):
    with pytest.raises(ValueError, match=name):
        PPOConfig(**{name: value})
