"""One policy step and the control steps in it."""

import matplotlib.pyplot as plt
import torch

from ppt_rl.functional.promp import unvec
from ppt_rl.modules import ProMP

torch.manual_seed(1)
promp = ProMP(num_basis=6, num_dof=1, duration=1.5)
phase = torch.linspace(0, 1, 151)
time = 1.5 * phase
figure, axes = plt.subplots(figsize=(8, 3), layout="constrained")
start, rate = torch.tensor(0.0), torch.tensor(0.0)
for chunk in range(3):
    rows = slice(50 * chunk, 50 * chunk + 51)
    now = phase[50 * chunk].view(1)
    weights = torch.randn(6) * 0.15 + 0.1 * chunk
    posterior = promp.posterior(
        now, start.view(1, 1), torch.full((1, 1, 1), 1e-8), None, rate.view(1, 1), torch.full((1, 1, 1), 1e-8),
        prior=type(promp.prior)(weights, torch.eye(6)),
    )  # fmt: skip
    position, velocity, _ = promp.decode(unvec(posterior.mean, 6), phase[rows])
    line = axes.plot(time[rows], position[:, 0], lw=2)[0]
    axes.plot(time[rows][::5], position[::5, 0], "|", color=line.get_color(), ms=8)
    axes.axvline(float(time[50 * chunk]), color="grey", ls="--", lw=1)
    axes.text(float(time[50 * chunk]) + 0.02, 0.92, f"policy step {chunk + 1}", transform=axes.get_xaxis_transform())
    start, rate = position[-1, 0], velocity[-1, 0]
axes.set(xlabel="time [s]", ylabel="reference [m]", ylim=(None, float(axes.get_ylim()[1]) * 1.3))
axes.set_title("three policy steps of 0.5 s; every fifth control step is marked", fontsize=10)
