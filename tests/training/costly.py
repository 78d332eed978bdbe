"""A small environment with a cost, and the batches of a collector on it."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.collectors import Collector
from torchrl.data import Composite, Unbounded
from torchrl.envs import EnvBase

from ppt_rl.functional import PIDGains
from ppt_rl.modules import PIDMultiplier, make_actor, make_critic
from ppt_rl.training import ConstrainedLearner, Constraint, Learner, PPOConfig


class CostlyEnv(EnvBase):
    """Every step pays its action and costs the square of it: so the best policy acts as much as the limit allows.

    Args:
        num_envs: number of environments.
        length: steps of an episode.
    """

    def __init__(self, num_envs: int = 64, length: int = 2) -> None:
        super().__init__(batch_size=torch.Size([num_envs]))
        self.length = length
        shape = (num_envs, 1)
        self.observation_spec = Composite(step=Unbounded(shape), cost=Unbounded(shape), shape=self.batch_size)
        self.action_spec, self.reward_spec = Unbounded(shape), Unbounded(shape)

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        zero = torch.zeros(*self.batch_size, 1)
        return TensorDict({"step": zero, "cost": zero.clone()}, self.batch_size)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        action, step = tensordict["action"], tensordict["step"] + 1
        done = step >= self.length
        after = {"step": step, "cost": action.square(), "reward": action, "done": done, "terminated": done.clone()}
        return TensorDict(after, self.batch_size)

    def _set_seed(self, seed: int | None) -> None:
        torch.manual_seed(0 if seed is None else seed)


def make_learner(
    limit: float | None, gains: PIDGains | None = None, *, cost_critic: bool = True, **ppo: Any
) -> Learner:
    """PPO on the environment, under a limit where there is one; the networks are the same after the same seed."""
    torch.manual_seed(0)
    actor, critic = make_actor(["step"], 1, 1, initial_scale=0.3), make_critic(["step"], 1)
    config = PPOConfig(**{"epochs": 4, "minibatches": 2, "target_kl": 0.05, **ppo})
    state = torch.get_rng_state()
    theirs = make_critic(["step"], 1, out_key="cost_value") if cost_critic else None
    torch.set_rng_state(state)
    if limit is None:
        return Learner(actor, critic, config)
    return ConstrainedLearner(actor, critic, config, Constraint(PIDMultiplier(limit, gains), theirs))


def batches(learner: Learner, count: int, *, steps: int = 2, **env: int) -> list[TensorDictBase]:
    """The next batches of a learner that does not learn."""
    return [batch for batch, _ in zip(collect(learner, steps=steps, **env), range(count), strict=False)]


def collect(learner: Learner, *, steps: int = 2, **env: int) -> Any:
    """Batches of so many steps of every environment, one by one."""
    costly = CostlyEnv(**env)
    frames = costly.batch_size.numel() * steps
    collector = Collector(costly, learner.actor, frames_per_batch=frames, total_frames=-1, trust_policy=True,
                          auto_register_policy_transforms=False)  # fmt: skip
    for batch in collector:
        yield batch.clone()
