"""
The maze by touch
=================

A cylinder slides through a corridor that the robot does not know. It has no map and no camera, only its joints and the
wrench at the wrist. The published policy was trained in straight corridors; here it meets turns and a ramp.
"""

# %%
# A maze of your own
# ------------------
#
# A maze is a list of segments: angles in radians, positive to the left, lengths in metres. The environment refuses a
# corridor that the tool cannot drive through, and says why.

from ppt_rl.envs import Disc, MazeLayout, Straight, Turn

layout = MazeLayout(
    (
        Straight(0.15),
        Turn(-0.5),
        Straight(0.18, rise=0.02),
        Turn(0.6),
        Straight(0.15),
        Disc(0.08, 0.3),
        Straight(0.15),
    ),
    start=(0.45, -0.25),
)

# %%
# One episode
# -----------
#
# ``make_env(given=[...])`` takes layouts in the place of random ones. The policy decides every 0.15 s, and at once
# when it feels a new wall.

import ppt_rl
from ppt_rl.evaluation import record_episodes

policy = ppt_rl.load_policy("ppt_maze")
env = policy.make_env(num_envs=1, seed=0, given=[layout])
keys = ["pose", "wrench", "heading", "via_position", "via_mask", "tank_energy", "progress"]
episode = record_episodes(env, policy.actor, keys)[0]
steps = int(episode["control_steps"])
trace = {key: value[:steps] for key, value in episode["trace"].items()}
print("reached the end:", bool(episode["success"]), f"after {0.01 * steps:.1f} s")

# %%
# What it felt
# ------------
#
# Every touch becomes a via-point along the wall: the force says on which side the wall is, the motion gives its
# direction. A dot is a via-point that was in the buffer at some time.

import matplotlib.pyplot as plt
import torch

time = 0.01 * torch.arange(1, steps + 1)
points = trace["via_position"][trace["via_mask"]].unique(dim=0)

figure, (above, force) = plt.subplots(2, 1, figsize=(9, 5), layout="constrained")
above.plot(trace["pose"][:, 1], trace["pose"][:, 0], color="tab:red", label="tool")
above.plot(points[:, 1], points[:, 0], "k.", ms=3, label="via-points from touch")
arrows = slice(None, None, 60)
heading = trace["heading"][arrows, 0]
above.quiver(
    trace["pose"][arrows, 1], trace["pose"][arrows, 0], heading.sin(), heading.cos(),
    angles="xy", scale=28, width=0.003, color="tab:blue", label="heading",
)  # fmt: skip
above.set(xlabel="y [m]", ylabel="x [m]", aspect="equal", title="from above")
above.invert_xaxis()
above.legend()
force.plot(time, trace["wrench"][:, :2].norm(dim=-1), lw=0.8)
force.set(xlabel="time [s]", ylabel="horizontal force [N]", title="at the wrist")
plt.show()

# %%
# Via-points gather where the corridor turns: this is where the tool meets a wall. Between them the heading follows
# the motion. In the heading frame a turn looks like a straight corridor that is entered at an angle, which is why
# straight corridors are enough to train on (:doc:`/concepts/touch`).
#
# How hard it is
# --------------
#
# Random mazes come from :meth:`~ppt_rl.envs.MazeEnv.mazes`. The metrics of an episode are measured on the way,
# whoever acts:

env = policy.make_env(num_envs=4, seed=11)
with torch.no_grad():
    rollout = env.rollout(200, policy.actor, break_when_any_done=False, break_when_all_done=True)
done = rollout["next", "done"].squeeze(-1)
first = done.int().argmax(1)
end = rollout["next"][torch.arange(4), first]
print("reached the end:", int(end["success"].sum()), "of 4 mazes")
print("P95 force [N]:", [round(float(f), 2) for f in end["metrics", "wrench_p95"]])

# %%
# ``ppt-rl evaluate ppt_maze --episodes 64 --baseline`` compares it with a hand-written wall follower, and
# :doc:`/results/maze` says what comes out of 200 mazes. :doc:`/maze` explains the parts.
