"""Where a touch puts via-points, in the world and in the heading frame."""

import math

import matplotlib.pyplot as plt
import torch

from ppt_rl.functional.contact import wall_contact
from ppt_rl.functional.heading import to_heading

wall = math.radians(30)  # direction of the wall
heading = torch.tensor([[math.radians(8)]])
along = torch.tensor([math.cos(wall), math.sin(wall)])
normal = torch.tensor([-math.sin(wall), math.cos(wall)])
friction = 0.25
force = torch.cat([2 * normal + 2 * friction * along, torch.tensor([0.0])]).unsqueeze(0)
felt = wall_contact(force, torch.zeros(1, 2), heading, friction=friction, slow=0.01)
ahead = torch.tensor([0.012, 0.024, 0.036]).unsqueeze(-1)
points = ahead * felt.tangent - 0.002 * felt.normal  # [m]
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
for axes, angle, title in ((left, torch.zeros(1, 1), "world"), (right, heading, "heading frame")):

    def turned(vector, angle=angle):
        three = torch.cat([vector, torch.zeros(*vector.shape[:-1], 1)], -1)
        return 100 * to_heading(three, angle.expand(len(three), 1))[:, :2]

    line = turned(torch.stack([-0.02 * along, 0.05 * along]) + 0.0125 * normal)
    axes.plot(*line.T, color="black", lw=3, label="wall")
    axes.add_patch(plt.Circle((0, 0), 1.25, color="tab:blue", alpha=0.4, label="tool"))
    way = torch.cat([heading.cos(), heading.sin()], -1)
    for vector, color, label in (
        (0.02 * way, "tab:blue", "heading"),
        (0.02 * force[:, :2] / force.norm(), "tab:orange", "force, tilted by friction"),
        (0.02 * felt.tangent, "tab:green", "tangent that follows from it"),
    ):
        axes.annotate("", turned(vector)[0], (0, 0), arrowprops={"arrowstyle": "->", "color": color, "lw": 2})
        axes.plot([], [], color=color, label=label)
    axes.plot(*turned(points).T, "kx", label="via-points")
    axes.set(xlabel="ahead [cm]" if title != "world" else "x [cm]", title=title, aspect="equal", xlim=(-2.5, 6))
    axes.set_ylim(-2, 5)
left.legend(fontsize=7, loc="upper left")
