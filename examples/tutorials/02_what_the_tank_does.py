"""
What the tank does
==================

An energy tank is a budget. It looks at the power of an effort, lets at most ``p_max`` through, and pays for what passes
from a store that holds ``e_max``. This page shows the law alone, then on a simulated arm, and then what it does *not*
do: a blocked tool.
"""

# %%
# The law alone
# -------------
#
# :func:`~ppt_rl.functional.energy_tank` is a pure function of effort, velocity and level. Take a force that swings
# between 0 and 10 N, on something that moves at 0.5 m/s, so that it asks for up to 5 W:

import matplotlib.pyplot as plt
import torch

from ppt_rl.functional import TANK_LAWS, energy_tank

dt, p_max, e_max = 0.01, 2.0, 1.3
time = dt * torch.arange(200)
force = 5 * (1 - torch.cos(2 * torch.pi * time))
velocity = torch.full_like(force, 0.5)

level, trace = torch.full((1, 1), e_max), []
for f, v in zip(force, velocity, strict=True):
    step = energy_tank(f.view(1, 1), v.view(1, 1), level, p_max=p_max, e_max=e_max, dt=dt)
    level = step.energy
    trace.append([float(f * v), float(step.power), float(step.energy), float(step.valve)])
asked, passed, levels, valve = torch.tensor(trace).T

figure, rows = plt.subplots(3, 1, figsize=(8, 6), sharex=True, layout="constrained")
rows[0].plot(time, asked, "--", color="grey", label="asked for")
rows[0].plot(time, passed, label="passes")
rows[0].set_ylabel("power [W]")
rows[0].legend()
rows[1].plot(time, levels)
rows[1].set_ylabel("level [J]")
rows[2].plot(time, valve)
rows[2].set(ylabel="valve [-]", xlabel="time [s]")
plt.show()

# %%
# The valve first holds the power at 2 W. When the level reaches zero, nothing passes any more: the energy of the
# whole record is bounded by what was in the tank.

print(f"largest power {passed.max():.3f} W, energy {dt * passed.sum():.3f} J of {e_max} J")

# %%
# In front of a policy
# --------------------
#
# In an environment the same law is one transform. First in the list it stands at the motors, where it bounds what is
# executed; :doc:`/concepts/energy_tank` says what that guarantees. Here the published policy pushes behind tanks of
# different capacities; ``with_changes`` sets an option of its recipe.

import ppt_rl
from ppt_rl.evaluation import record_episodes

policy = ppt_rl.load_policy("ppt_push")
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
for capacity in (1.3, 0.9, 0.5):
    env = policy.with_changes(e_max=capacity).make_env(num_envs=32, seed=1)
    episode = record_episodes(env, policy.actor, ["tank_energy", "progress"])
    time = 0.01 * torch.arange(1, 151)
    label = f"{capacity} J: success {episode['success'].float().mean():.2f}"
    left.plot(time, episode["trace", "tank_energy"].mean((0, 2)), label=label)
    right.plot(time, episode["trace", "progress"].mean((0, 2)))
left.set(xlabel="time [s]", ylabel="level [J]", title="mean level of 32 episodes")
left.legend()
right.set(xlabel="time [s]", ylabel="progress [-]", title="mean progress")
plt.show()

# %%
# This policy was trained behind 1.3 J. With less, the tank is empty before the box is there, and the arm lets go.
#
# A blocked tool
# --------------
#
# Power is force times velocity. A tool that is blocked does not move, so its power is zero, and **a tank lets any
# force pass**. We put a wall where the tool runs into it at full speed and read the force at the wrist, for three
# policies: without a tank, behind one, and behind one with a governor of the reference (``ppt_safe_push``).

from ppt_rl.envs.push import WALL, Obstacle
from ppt_rl.tasks.push import make_push_env

figure, axes = plt.subplots(1, 3, figsize=(12, 3.6), layout="constrained")
for name in ("pp_push", "ppt_push", "ppt_safe_push"):
    policy = ppt_rl.load_policy(name)
    base = make_push_env(policy.config, num_envs=8, seed=5, obstacle=Obstacle((WALL,)))
    env = policy.recipe.on(base, policy.config, policy.modules)
    keys = ["wrench", "power", *(["tank_energy"] if policy.recipe.has_tank else [])]
    trace = record_episodes(env, policy.actor, keys)["trace"]
    steady = trace["wrench"][:, -20:, :3].norm(dim=-1).mean()
    label = f"{policy.recipe.label}: {steady:.0f} N at the end"
    axes[0].plot(time, trace["wrench"][..., :3].norm(dim=-1).mean(0), label=label)
    axes[1].plot(time, trace["power"].abs().mean((0, 2)))
    if "tank_energy" in trace:
        axes[2].plot(time, trace["tank_energy"].mean((0, 2)), color=axes[0].lines[-1].get_color())
axes[0].set(xlabel="time [s]", ylabel="force at the wrist [N]", yscale="symlog")
axes[0].legend(fontsize=8)
axes[1].set(xlabel="time [s]", ylabel="|power| [W]")
axes[2].set(xlabel="time [s]", ylabel="level [J]")
plt.show()

# %%
# The peaks are impacts: they happen within one control step, and no layer sees them coming. Without a tank, the force
# then stays where spring and damper want it, although the power has fallen to zero. Behind a tank little force is
# left here, but only **because the tank is empty** by then; where it is not, nothing limits the force. Only the
# governor has a bound on it. :doc:`/safety` measures this at 2 kHz, in 256 episodes of each of eight scenarios.
#
# Other laws
# ----------
#
# The paper's law charges braking like pushing. Other laws stand behind the same transform, by name:

print("modes:", ", ".join(TANK_LAWS))
