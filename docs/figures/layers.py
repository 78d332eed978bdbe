"""The chain from policy to motors, with what each layer bounds."""

import matplotlib.pyplot as plt

stages = [
    ("policy", "residual weights", "mean cost, constrained PPO"),
    ("ProMP + via-points", "references", "smoothness"),
    ("governor", "reference", "force on a blocked tool"),
    ("impedance", "wrench", "stiffness x lead"),
    ("tank (paper)", "wrench", "power, work of the task"),
    ("joint torque", "torque", "torque, its rate"),
    ("tank at the motors", "torque", "power, work executed"),
    ("robot", "motion", "the audit measures, 2 kHz"),
]
figure, axes = plt.subplots(figsize=(9.5, 3.0), layout="constrained")
for i, (name, output, bound) in enumerate(stages):
    tank = "tank" in name
    box = {"boxstyle": "round,pad=0.4", "fc": "#dbe9f6" if not tank else "#fde3c8", "ec": "#3c4654"}
    axes.text(i, 0.6, name.replace(" ", "\n", 1), ha="center", va="center", bbox=box, fontsize=8.5)
    axes.text(
        i,
        -0.25,
        bound.replace(", ", ",\n")
        .replace(" on ", "\non ")
        .replace(" executed", "\nexecuted")
        .replace(" of the ", "\nof the ")
        .replace(" measures", "\nmeasures"),
        ha="center",
        va="center",
        fontsize=8,
        color="#8a3b12",
    )
    if i < len(stages) - 1:
        axes.annotate("", (i + 0.62, 0.6), (i + 0.4, 0.6), arrowprops={"arrowstyle": "->"})
        axes.text(i + 0.5, 1.15, output, ha="center", fontsize=7.5, color="#3c4654")
axes.text(-0.6, -0.95, "below each stage: what it bounds", fontsize=8, color="#8a3b12")
axes.set(xlim=(-0.7, len(stages) - 0.3), ylim=(-1.0, 1.4))
axes.axis("off")
