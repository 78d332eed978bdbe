"""A step of the reference, followed by an impedance with three damping ratios, and what pushes on a blocked tool."""

import matplotlib.pyplot as plt
import torch

from ppt_rl.functional import cartesian_impedance, critical_damping

stiffness, inertia, dt = torch.tensor([400.0] * 3 + [30.0] * 3), torch.tensor([3.0] * 3 + [0.1] * 3), 0.001
upright = torch.tensor([1.0, 0.0, 0.0, 0.0])
reference = torch.cat([torch.tensor([0.05, 0.0, 0.0]), upright])
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3), layout="constrained")
time = dt * torch.arange(600)
for ratio in (0.3, 0.7, 1.0):
    damping = critical_damping(stiffness, torch.full((6,), ratio), inertia)
    position, velocity, path, force = torch.zeros(3), torch.zeros(3), [], []
    for _ in time:
        pose, twist = torch.cat([position, upright]), torch.cat([velocity, torch.zeros(3)])
        wrench = cartesian_impedance(pose, twist, reference, torch.zeros(6), stiffness, damping)
        velocity = velocity + dt * wrench[:3] / inertia[:3]
        position = position + dt * velocity
        path.append(float(position[0]))
        force.append(float(wrench[0]))
    left.plot(time, path, label=f"damping ratio {ratio}")
    right.plot(time, force)
left.axhline(0.05, color="grey", ls="--", lw=1)
left.set(xlabel="time [s]", ylabel="position [m]", title="free, 3 kg, 400 N/m")
left.legend(fontsize=8)
right.set(xlabel="time [s]", ylabel="force [N]", title="force of spring and damper")
