"""
Constrained PPO
===============

A tank bounds the energy of every episode, whatever the policy does. Constrained PPO asks the policy itself to keep the
**mean** of a cost below a limit. This page does both, on the task of :doc:`05_ppo_on_promp_weights`.
"""

# %%
# A cost
# ------
#
# A cost is an entry ``("next", "cost")``. Here it is the work of an episode, ``sum |force . velocity| dt``.
# :class:`~ppt_rl.transforms.PowerLimitTransform` writes it from a measured force and velocity; a limit of zero makes
# it the whole work. It stands before the macro step, which sums the cost over the episode. The chain has no tank.

import matplotlib.pyplot as plt
import torch
from torchrl.collectors import Collector
from torchrl.envs import Compose, TransformedEnv, UnaryTransform, set_exploration_type
from torchrl.envs.utils import ExplorationType
from wind import Wind

from ppt_rl.functional import PIDGains
from ppt_rl.modules import JointSpace, PIDMultiplier, ProMP
from ppt_rl.training import ConstrainedLearner, Constraint, PPOConfig, make_actor_critic, make_cost_critic
from ppt_rl.transforms import MacroStepTransform, PDTrackingTransform, PowerLimitTransform, ProMPTransform

K, STEPS = 6, Wind.horizon
promp = ProMP(num_basis=K, num_dof=2, duration=STEPS * Wind.control_dt)


def towards(target):
    """Weights of a motion from the origin to the target."""
    share = torch.tensor([0.0, 0.0, 0.3, 0.7, 1.0, 1.0])
    return share.unsqueeze(-1) * target.unsqueeze(-2)  # (*B, K, 2)


def make_env(num_envs, seed):
    """Environments with a cost in the place of a tank."""
    chain = [
        PDTrackingTransform(stiffness=60.0, damping=12.0),
        PowerLimitTransform(p_max=0.0, wrench_key="force", twist_key="joint_velocity"),
        MacroStepTransform(STEPS),
        ProMPTransform(promp, JointSpace(2), residual_scale=0.3, pose_key="joint_position"),
        UnaryTransform(["target"], ["weights_mean"], fn=towards),
    ]
    return TransformedEnv(Wind(num_envs, seed), Compose(*chain))


# %%
# A limit and its multiplier
# --------------------------
#
# The policy improves on ``(reward - lambda cost) / (1 + lambda)``. After every batch a PID controller moves
# ``lambda`` by how far the mean cost is above the limit, so nobody has to find the weight of a penalty by trial.
# Reward and cost have a critic each (:class:`~ppt_rl.training.ConstrainedLearner`).

KEYS = ("target", "wind")


def train(limit, batches=45):
    """PPO under a limit on the mean work of an episode [J]."""
    torch.manual_seed(0)
    env = make_env(256, seed=0)
    actor, critic = make_actor_critic(env, KEYS, KEYS, initial_scale=0.2)
    multiplier = PIDMultiplier(limit, PIDGains(proportional=4.0, integral=0.4))
    constraint = Constraint(multiplier, make_cost_critic(env, KEYS))
    learner = ConstrainedLearner(actor, critic, PPOConfig(learning_rate=1e-3, target_kl=0.05), constraint)
    collector = Collector(
        env, actor, frames_per_batch=256, total_frames=256 * batches, auto_register_policy_transforms=False
    )
    log = []
    for batch in collector:
        scalars = learner.update(batch)
        success = float(batch["next", "success"].float().mean())
        log.append([scalars["cost"], scalars["multiplier"], success])
    collector.shutdown()
    return actor, torch.tensor(log)


runs = {limit: train(limit) for limit in (100.0, 1.2)}

# %%
# A limit of 100 J never binds; its multiplier stays at zero, and an update is that of PPO. With the lower limit the
# policy first learns to be thrifty, then to arrive, more slowly. Once the mean is below the limit, the multiplier
# falls again: a limit is no price, and what is below it costs nothing.

figure, axes = plt.subplots(1, 3, figsize=(12, 3.6), layout="constrained")
for limit, (_, log) in runs.items():
    for column, name in enumerate(("mean work of an episode [J]", "multiplier", "success while exploring")):
        axes[column].plot(log[:, column], label=f"limit {limit:g} J")
        axes[column].set(xlabel="batch of 256 episodes", ylabel=name)
axes[0].axhline(1.2, color="grey", ls="--")
axes[0].legend()
plt.show()

# %%
# What it promises, and what not
# ------------------------------
#
# In fresh episodes without exploration:

for limit, (actor, log) in runs.items():
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        end = make_env(256, seed=1).rollout(1, actor)["next"][:, 0]
    work = end["cost"]
    print(
        f"limit {limit:5g} J: success {end['success'].float().mean():.2f}, "
        f"work {work.mean():.2f} J on average, {work.max():.2f} J at most; exploring {log[-10:, 0].mean():.2f} J"
    )

# %%
# The limit is one of the mean while exploring, and exploring costs work too, so without it the mean is lower. Single
# episodes exceed it. Where no episode may, put a tank into the chain. Both together are what :doc:`/results/safety`
# measures on the Panda: a policy that has learnt to be thrifty loses little when a tank is added afterwards.
