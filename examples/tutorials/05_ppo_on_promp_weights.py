"""
PPO on ProMP weights from scratch
=================================

No robot, no recipe, no checkpoint: a task of fifty lines, the method as a list of transforms, and PPO written out with
torchrl's own parts. At the end a policy has learnt to lean into a wind.
"""

# %%
# The task
# --------
#
# A mass of 1 kg has to be at a target after one second. On the way a sidewind of up to 8 N blows. The wind is known
# beforehand, but nobody says what to do about it.
#
# .. literalinclude:: ../../examples/tutorials/wind.py
#    :language: python
#    :pyobject: Wind
#
# The method is a list
# --------------------
#
# One action is a residual on the weights of a movement primitive, that is, a whole motion of one second. A PD
# controller tracks it, behind a tank at the motor. The reference moves smoothly from where the mass stands to the
# target; this is the function ``towards``, which takes the place of via-points here.

import matplotlib.pyplot as plt
import torch
from torchrl.collectors import Collector
from torchrl.envs import Compose, TransformedEnv, UnaryTransform, set_exploration_type
from torchrl.envs.utils import ExplorationType
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE
from wind import Wind

from ppt_rl.modules import JointSpace, ProMP
from ppt_rl.training import make_actor_critic
from ppt_rl.transforms import EnergyTankTransform, MacroStepTransform, PDTrackingTransform, ProMPTransform

K, STEPS = 6, Wind.horizon
promp = ProMP(num_basis=K, num_dof=2, duration=STEPS * Wind.control_dt)


def towards(target):
    """Weights of a motion from the origin to the target: their share of the way, spread over the basis functions."""
    share = torch.tensor([0.0, 0.0, 0.3, 0.7, 1.0, 1.0])
    return share.unsqueeze(-1) * target.unsqueeze(-2)  # (*B, K, 2)


def make_env(num_envs, seed):
    """Environments with the chain of the method."""
    chain = [
        EnergyTankTransform(p_max=5.0, e_max=2.5),  # at the motor: bounds what is executed    every control step
        PDTrackingTransform(stiffness=60.0, damping=12.0),  # reference -> force               every control step
        MacroStepTransform(STEPS),  # one policy step = 50 control steps
        ProMPTransform(promp, JointSpace(2), residual_scale=0.3, pose_key="joint_position"),  # once per policy step
        UnaryTransform(["target"], ["weights_mean"], fn=towards),  # the reference             once per policy step
    ]
    return TransformedEnv(Wind(num_envs, seed), Compose(*chain))


torch.manual_seed(0)
env = make_env(256, seed=0)
keys = ("target", "wind")
actor, critic = make_actor_critic(env, keys, keys, initial_scale=0.3)

# %%
# PPO, written out
# ----------------
#
# An episode is one policy step, so a batch of 256 episodes is 256 decisions. ``Learner`` in :mod:`ppt_rl.training`
# does the same with an adaptive learning rate; here are its parts.

loss_of = ClipPPOLoss(actor, critic, clip_epsilon=0.2, entropy_bonus=False, normalize_advantage=True)
advantage = GAE(gamma=1.0, lmbda=0.95, value_network=critic)
optimizer = torch.optim.Adam(loss_of.parameters(), lr=1e-3)

history = []
collector = Collector(env, actor, frames_per_batch=256, total_frames=256 * 60, auto_register_policy_transforms=False)
for batch in collector:
    with torch.no_grad():
        batch = advantage(batch).reshape(-1)
    for _ in range(8):
        for rows in torch.randperm(len(batch)).chunk(4):
            losses = loss_of(batch[rows])
            loss = losses["loss_objective"] + losses["loss_critic"]
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
    history.append([float(batch["next", "reward"].mean()), float(batch["next", "success"].float().mean())])
collector.shutdown()

# %%
# What it learnt
# --------------
#
# Without exploration, in fresh episodes, beside the reference alone (a residual of zero):


def judge(act, seed=1):
    """Fresh episodes of an actor, with its mean action."""
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        return make_env(256, seed).rollout(1, act)["next"][:, 0]


def reference_alone(td):
    """The action zero."""
    return td.set("action", torch.zeros(256, 2 * K))


before, after = judge(reference_alone), judge(actor)
for name, end in (("reference alone", before), ("PPO", after)):
    miss = (end["joint_position"] - end["target"]).norm(dim=-1)
    print(f"{name:16s} success {end['success'].float().mean():.2f}, mean miss {100 * miss.mean():.1f} cm")

figure, (curve, where) = plt.subplots(1, 2, figsize=(11, 3.8), layout="constrained")
curve.plot([success for _, success in history])
curve.set(xlabel="batch of 256 episodes", ylabel="success while exploring", ylim=(0, 1))
for name, end in (("reference alone", before), ("PPO", after)):
    where.plot(end["wind"][:, 1], (end["joint_position"] - end["target"])[:, 1], ".", label=name)
where.axhspan(-0.02, 0.02, color="grey", alpha=0.3)
where.set(xlabel="wind [N]", ylabel="miss across [m]", title="within the band: success")
where.legend()
plt.show()

# %%
# The tank never let more through than it may, before, during and after learning:

energy = 2.5 - after["tank_energy"]
print(f"largest energy of an episode: {energy.max():.2f} J of 2.5 J")

# %%
# Next: :doc:`06_constrained_ppo` asks the same policy to be thrifty, and :doc:`/howto/own_task` makes a task that the
# command ``ppt-rl`` trains, evaluates and films.
