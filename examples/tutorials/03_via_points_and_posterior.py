"""
Via-points and the posterior
============================

A probabilistic movement primitive (ProMP) is a normal distribution over trajectories. Conditioning it on a few points
gives another one, in closed form: smooth, through the points, and uncertain elsewhere. This is where the method gets
its reference from, before anything is learnt.
"""

# %%
# A prior from demonstrations
# ---------------------------
#
# A trajectory is ``y(phase) = Phi(phase) W``: six basis functions, weighted. Fifty demonstrations of a reach with a
# bump, of different heights and lengths, give mean and covariance of the weights.

import matplotlib.pyplot as plt
import torch

from ppt_rl.functional.promp import unvec
from ppt_rl.modules import ProMP

torch.manual_seed(0)
s = torch.linspace(0, 1, 101)
smooth = s**3 * (10 - 15 * s + 6 * s**2)  # from rest to rest
reach, bump = 0.3 + 0.05 * torch.randn(50, 1), 0.06 * torch.randn(50, 1)
demonstrations = (reach * smooth + bump * torch.sin(torch.pi * s) ** 2).unsqueeze(-1)  # (50, 101, 1) [m]

promp = ProMP(num_basis=6, num_dof=1, duration=1.5).fit(demonstrations)


def band(axes, mean, cov, color, label):
    """Draw the mean of a distribution over weights, and two standard deviations around it."""
    basis, _, _ = promp.basis(s)
    position, _, _ = promp.decode(unvec(mean, promp.num_basis), s)
    sigma = torch.einsum("tk,kl,tl->t", basis, cov, basis).clamp_min(0).sqrt()
    centre = position[:, 0]
    axes.plot(s, centre, color=color, label=label)
    axes.fill_between(s, centre - 2 * sigma, centre + 2 * sigma, color=color, alpha=0.2, lw=0)


figure, (left, middle) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
left.plot(s, promp.basis(s)[0])
left.set(title="six normalised basis functions", xlabel="phase [-]")
middle.plot(s, demonstrations[:12, :, 0].T, color="grey", lw=0.7)
band(middle, *promp.prior, "tab:blue", "prior")
middle.set(title="demonstrations and the prior", xlabel="phase [-]", ylabel="y [m]")
middle.legend()
plt.show()

# %%
# Conditioning on via-points
# --------------------------
#
# A via-point is a phase, a position and a covariance: how much it matters. All are conditioned on at once; an order
# does not exist. Masked entries have no effect, so a batch may hold different numbers of via-points.

phase = torch.tensor([0.4, 1.0])
position = torch.tensor([[0.22], [0.30]])
cov = torch.diag_embed(torch.tensor([[0.004], [0.01]]).square())
posterior = promp.posterior(phase, position, cov)

figure, right = plt.subplots(figsize=(7, 3.6), layout="constrained")
band(right, *promp.prior, "tab:blue", "prior")
band(right, *posterior, "tab:red", "posterior")
right.errorbar(phase, position[:, 0], 2 * cov[:, 0, 0].sqrt(), fmt="kx", label="via-points")
right.set(title="conditioned on two via-points", xlabel="phase [-]", ylabel="y [m]")
right.legend()
plt.show()

# %%
# Far from the via-points the posterior keeps the shape of the demonstrations. The mean passes the first via-point
# closer than the second, because its covariance is smaller.

reached = promp.decode(unvec(posterior.mean, 6), phase)[0]
print("asked for", position[:, 0].tolist(), "- mean", [round(float(y), 4) for y in reached[:, 0]])

# %%
# Velocity comes for free
# -----------------------
#
# The derivatives of the basis are analytic, so the reference has a velocity that the impedance controller follows:

_, velocity, acceleration = promp.decode(unvec(posterior.mean, 6), s)
print(f"largest velocity {velocity.abs().max():.2f} m/s, largest acceleration {acceleration.abs().max():.1f} m/s^2")

# %%
# In the task
# -----------
#
# Pushing has three via-points in x, y and yaw: where the tool stands, behind the box, and touching the box at its
# goal. :class:`~ppt_rl.transforms.ViaPointTransform` conditions the prior on them at every policy step and writes the
# posterior under ``weights_mean``; the policy adds a residual to it. With a residual of zero you see the reference
# alone:

from ppt_rl.envs import PushEnv
from ppt_rl.tasks.push import fit_push_prior

push = fit_push_prior(ProMP(num_basis=6, num_dof=3, duration=1.5), goal="pose")
env = PushEnv(num_envs=4, goal="pose", duration=1.5, seed=2)
episode = env.reset()
posterior = push.posterior(episode["via_phase"], episode["via_position"], episode["via_cov"], episode["via_mask"])
path, _, _ = push.decode(unvec(posterior.mean, 6), torch.linspace(0, 1, 150))  # (4, 150, 3)

figure, axes = plt.subplots(figsize=(7, 4.5), layout="constrained")
for row in range(4):
    line = axes.plot(path[row, :, 0], path[row, :, 1])[0]
    axes.plot(*episode["via_position"][row, :, :2].T, "x", color=line.get_color())
    axes.plot(*episode["box_start"][row], "s", color=line.get_color(), ms=12, fillstyle="none")
    axes.plot(*episode["goal"][row], "*", color=line.get_color(), ms=10)
axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title="references of four pushes (box: square, goal: star)")
plt.show()
