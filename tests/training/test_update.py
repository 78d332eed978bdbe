"""A whole update against torchrl's own parts."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from ppt_rl.modules import make_actor, make_critic
from ppt_rl.training.ppo import Learner, PPOConfig


def episodes(actor, count, steps):
    """Steps ``(count, steps)`` on a path, with episodes that end or are cut off here and there."""
    path = torch.randn(count, steps + 1, 2)
    with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
        data = actor(TensorDict({"observation": path[:, :-1]}, [count, steps], names=[None, "time"]))
    terminated, truncated = torch.rand(count, steps, 1) < 0.1, torch.rand(count, steps, 1) < 0.1
    following = {
        "observation": path[:, 1:], "reward": torch.randn(count, steps, 1), "done": terminated | truncated,
        "terminated": terminated, "truncated": truncated & ~terminated,
        "control_steps": torch.randint(1, 9, (count, steps, 1)),
    }  # fmt: skip
    data["next"] = TensorDict(following, [count, steps])
    return data


def by_torchrl(ppo, data):
    """An update as torchrl's own parts make it: two evaluations of every value, the whole loss, plain Adam."""
    config, actor, critic = ppo.config, ppo.actor, ppo.critic
    estimator = GAE(gamma=config.gamma, lmbda=config.gae_lambda, value_network=critic, average_gae=False)
    estimator.set_keys(steps_to_next_obs=("next", "control_steps"))
    loss = ClipPPOLoss(
        actor, critic, clip_epsilon=config.clip, entropy_bonus=config.entropy > 0, entropy_coeff=config.entropy,
        critic_coeff=1.0, normalize_advantage=True, loss_critic_type="smooth_l1",
    )  # fmt: skip
    adam = torch.optim.Adam(loss.parameters(), lr=config.learning_rate, eps=1e-5)
    with torch.no_grad():
        flat = estimator(data.clone()).reshape(-1)
    for _ in range(config.epochs):
        for rows in torch.randperm(len(flat)).chunk(config.minibatches):
            losses = loss(flat[rows])
            adam.zero_grad()
            sum(losses[name] for name in losses.keys() if name.startswith("loss_")).backward()
            torch.nn.utils.clip_grad_norm_(loss.parameters(), config.max_grad_norm)
            adam.step()
    old = torch.distributions.Normal(flat["loc"], flat["scale"])
    kl = torch.distributions.kl_divergence(old, actor.get_dist(flat.select("observation")).base_dist).sum(-1).mean()
    return float(kl), [value.detach() for value in loss.parameters()]


@pytest.mark.parametrize("entropy", [0.0, 0.01])
@pytest.mark.parametrize("threads", [1, 2])
def test_an_update_is_that_of_torchrls_own_loss_and_estimator(entropy, threads):
    settings = {
        "epochs": 3,
        "minibatches": 3,
        "target_kl": 1e9,
        "entropy": entropy,
        "gamma": 0.99,
        "max_grad_norm": 0.5,
        "max_learning_rate": PPOConfig.learning_rate,  # torchrl's parts have no schedule
    }
    made = []
    for _ in range(2):
        torch.manual_seed(0)
        actor = make_actor(["observation"], 2, 2, initial_scale=0.5)
        made.append(Learner(actor, make_critic(["observation"], 2), PPOConfig(**settings), threads))
    ours, theirs = made
    torch.manual_seed(1)
    data = episodes(ours.actor, 50, 20)
    torch.manual_seed(2)
    told = ours.update(data)
    torch.manual_seed(2)
    kl, parameters = by_torchrl(theirs, data)
    assert told["kl"] == pytest.approx(kl, rel=1e-3)
    assert told["kl"] > 1e-4
    for one, other in zip(ours.objective.parameters, parameters, strict=True):
        torch.testing.assert_close(one.detach(), other, rtol=1e-3, atol=2e-6)
