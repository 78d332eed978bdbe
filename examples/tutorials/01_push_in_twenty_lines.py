"""
A push in twenty lines
======================

Load a published policy, let it push eight boxes, and look at what happened. You need nothing but the installed package:
the policy, its recipe and its movement primitive are part of it.
"""

# %%
# The whole thing
# ---------------
#
# A :class:`~ppt_rl.Policy` is an actor together with the chain of transforms that it was trained through. Its
# environment simulates a Panda with a paddle; the actor decides **once per episode**: one action is a whole motion of
# 1.5 s.

import torch

import ppt_rl

policy = ppt_rl.load_policy("ppt_push")
env = policy.make_env(num_envs=8, seed=3)
with torch.no_grad():
    rollout = env.rollout(1, policy.actor)
end = rollout["next"][:, 0]

for row in range(8):
    power, work = (float(end["metrics", name][row]) for name in ("max_power", "work"))
    verdict = "at the goal" if end["success"][row] else "missed"
    print(f"box {row}: {verdict:11s}  largest power {power:.2f} W, work {work:.2f} J")

# %%
# ``rollout(1, ...)`` is one policy step. Within it the chain ran 150 control steps at 100 Hz, and the engine 3,000
# steps of the physics. An action has one number for each weight of the movement primitive:

print("action:", tuple(rollout["action"].shape), "- control steps:", end["control_steps"].flatten().tolist())

# %%
# What the policy saw, and what it did not
# ----------------------------------------
#
# The environment of a test leaves out the privileged observations, such as the pose of the box while it moves. What
# remains is known before the push: where the box stands, how large it is, and where it should go.

keys = [key for key in policy.actor.in_keys if isinstance(key, str)]
print("the policy reads:", ", ".join(sorted(keys)))

# %%
# Look at it
# ----------
#
# :func:`~ppt_rl.evaluation.record_episodes` records any observation at every control step. With ``privileged=True``
# the pose of the box is there to be drawn; the policy still does not read it.

import matplotlib.pyplot as plt
import numpy as np

from ppt_rl.evaluation import record_episodes

env = policy.make_env(num_envs=8, seed=3, privileged=True)
episode = record_episodes(env, policy.actor, ["pose", "box_pose", "power", "tank_energy"])

figure, (above, side) = plt.subplots(1, 2, figsize=(11, 4.5), layout="constrained")
for row in range(3):
    tool, box = episode["trace", "pose"][row], episode["trace", "box_pose"][row]
    goal, yaw, half = episode["goal"][row], float(episode["goal_yaw"][row]), 0.5 * float(episode["box_size"][row])
    line = above.plot(tool[:, 0], tool[:, 1], lw=1.5)[0]
    above.plot(box[:, 0], box[:, 1], ":", color=line.get_color())
    corners = half * np.array([[1, 1], [1, -1], [-1, -1], [-1, 1], [1, 1]])
    turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    above.plot(*(corners @ turn + goal.numpy()).T, "--", color="grey", lw=1)
above.set(xlabel="x [m]", ylabel="y [m]", title="tool (line), centre of the box (dots), goal (dashes)", aspect="equal")

time = 0.01 * np.arange(1, 151)
side.plot(time, episode["trace", "power"][:3, :, 0].T)
side.axhline(2.0, color="grey", ls="--")
side.set(xlabel="time [s]", ylabel="power of the task's wrench [W]", title="the tank closes at 2 W")
plt.show()

# %%
# Where to go from here
# ---------------------
#
# * :doc:`02_what_the_tank_does` explains the dashed line in the right-hand picture.
# * ``ppt-rl evaluate ppt_push --episodes 512 --baseline`` judges the same policy on fresh episodes.
# * ``ppt-rl train ppt_push --run-dir runs/mine`` trains one (6.4 to 7.0 minutes on two cores).
