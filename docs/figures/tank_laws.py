"""The laws of the tank on one signal: push, brake, push."""

import matplotlib.pyplot as plt
import torch

from ppt_rl.functional import TANK_LAWS

dt, time = 0.01, 0.01 * torch.arange(180)
velocity = 0.5 * torch.sin(2 * torch.pi * time / 1.2)
force = 8 * torch.cos(2 * torch.pi * time / 1.2) + 3 * torch.sign(velocity)
figure, (above, middle, below) = plt.subplots(3, 1, figsize=(8, 6), sharex=True, layout="constrained")
above.plot(time, force * velocity, "--", color="grey", label="asked for")
for name, law in TANK_LAWS.items():
    level, rows = torch.full((1, 1), 1.0), []
    more = (
        {"damping": torch.zeros(1, 1)}
        if name == "parallel"
        else {"inertia": torch.tensor([3.0])}
        if name in ("rate", "impact")
        else {}
    )
    for f, v in zip(force.view(-1, 1, 1), velocity.view(-1, 1, 1), strict=True):
        if name == "parallel":  # the braking part of the damper, here all that brakes
            more = {"damping": torch.where(f * v < 0, f, 0.0)}
        step = law(f, v, level, p_max=1.5, e_max=1.0, dt=dt, eps=1e-6, **more)
        executed = more.get("damping", 0.0) + step.valve * (f - more.get("damping", 0.0))
        level = step.energy
        rows.append([float(executed * v), float(level), float(step.valve)])
    power, levels, valve = torch.tensor(rows).T
    above.plot(time, power, label=name)
    middle.plot(time, levels)
    below.plot(time, valve)
above.set_ylabel("power [W]")
above.legend(fontsize=8, ncol=5, loc="lower right")
middle.set_ylabel("level [J]")
below.set(ylabel="valve [-]", xlabel="time [s]")
above.set_title("1.5 W, 1 J, at the beginning of every control step", fontsize=10)
