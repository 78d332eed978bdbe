"""Rates: physics, control, policy."""

import matplotlib.pyplot as plt

figure, axes = plt.subplots(figsize=(9, 2.2), layout="constrained")
for y, (name, period) in enumerate(
    (("physics, 2 kHz", 0.5), ("control, 100 Hz", 10.0), ("policy, every 75 control steps", 750.0))
):
    ticks = [period * i for i in range(int(40 / period) + 1)]
    axes.eventplot(ticks, lineoffsets=y, linelengths=0.7, colors=f"C{y}", linewidths=0.8 if y == 0 else 2.5)
    axes.text(-0.6, y, name, ha="right", va="center", fontsize=9)
axes.set(xlim=(-0.5, 40.5), xlabel="time [ms]", yticks=[])
axes.spines[["left", "top", "right"]].set_visible(False)
axes.set_title("the torque is held for 20 steps of the physics; a tank looks once", fontsize=10)
