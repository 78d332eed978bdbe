"""Apparent inertia of the arm in the push workspace: where the default damping and nullspace inertia come from."""

from __future__ import annotations

import numpy as np
import torch

from ppt_rl.arms.panda import HOME
from ppt_rl.envs import PandaEnv
from ppt_rl.envs.mujoco_imports import mujoco
from ppt_rl.modules import PandaKinematics


def main(samples: int = 500) -> None:
    """Print medians of the diagonal of the joint-space and of the operational-space inertia."""
    env = PandaEnv()
    model, kinematics = env.engine.models[0], PandaKinematics(env.tool_length, dtype=torch.float64)
    data = mujoco.MjData(model)
    generator = np.random.default_rng(0)
    x, y = generator.uniform(0.36, 0.70, samples), generator.uniform(-0.15, 0.15, samples)
    down = np.tile([0.02, 0.0, 1.0, 0.0, 0.0], (samples, 1))
    pose = torch.from_numpy(np.concatenate([x[:, None], y[:, None], down], 1))
    positions = kinematics.inverse(pose, torch.tensor(HOME, dtype=torch.float64).expand(samples, 7)).numpy()
    joint, task = [], []
    site = model.site("end_effector").id
    for position in positions:
        data.qpos[:7] = position
        mujoco.mj_forward(model, data)
        inertia = np.zeros((7, 7))
        for column, unit in enumerate(np.eye(7)):
            mujoco.mj_mulM(model, data, inertia[column], unit)
        jacobian = np.zeros((6, 7))
        mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], site)
        joint.append(np.diag(inertia))
        task.append(np.diag(np.linalg.inv(jacobian @ np.linalg.solve(inertia, jacobian.T))))
    print("joint space [kg m^2]          ", np.median(joint, 0).round(3))
    print("operational space [kg, kg m^2]", np.median(task, 0).round(2))


if __name__ == "__main__":
    main()
