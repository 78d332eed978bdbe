"""Typical inertia of an arm with the paddle, over the workspace of the pushing task.

An arm's file states these medians as ``Joints.inertia`` and ``Arm.apparent_inertia``. The nullspace projection and the
damping of the impedance follow from them. ``python benchmarks/apparent_inertia.py --arm ur5e``
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from ppt_rl.arms import Arm, find_arm
from ppt_rl.envs import ArmEnv
from ppt_rl.envs.mujoco_imports import mujoco
from ppt_rl.modules import Kinematics
from ppt_rl.training import run_script


@dataclass(frozen=True)
class Config:
    """Print the typical inertia of an arm.

    Attributes:
        arm: name of the arm.
        samples: number of tool poses over which the medians are taken.
        seed: seed of the poses.
    """

    arm: str = "panda"
    samples: int = 500
    seed: int = 0


def joint_positions(arm: Arm, tool_length: float, samples: int, seed: int) -> np.ndarray:
    """Joint positions ``(samples, n)`` with the tool down at the table, between the starts and goals of pushes."""
    generator = np.random.default_rng(seed)
    x, y = generator.uniform(0.36, 0.70, samples), generator.uniform(-0.15, 0.15, samples)
    down = np.tile(ArmEnv.start_pose[2:], (samples, 1))
    pose = torch.from_numpy(np.concatenate([x[:, None], y[:, None], down], 1))
    home = torch.tensor(arm.home, dtype=torch.float64).expand(samples, -1)
    return Kinematics(arm, tool_length, dtype=torch.float64).inverse(pose, home).numpy()


def inertias(arm: Arm, samples: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Diagonals of the inertia in joint space ``(samples, n)`` and in operational space ``(samples, 6)``."""
    env, count = ArmEnv(arm=arm), arm.num_joints
    model = env.engine.models[0]
    data, site = mujoco.MjData(model), model.site("end_effector").id
    joint, task = [], []
    for position in joint_positions(arm, env.tool_length, samples, seed):
        data.qpos[:] = position
        mujoco.mj_forward(model, data)
        inertia, jacobian = np.zeros((count, count)), np.zeros((6, count))
        for column, unit in enumerate(np.eye(count)):
            mujoco.mj_mulM(model, data, inertia[column], unit)
        mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], site)
        joint.append(np.diag(inertia))
        task.append(np.diag(np.linalg.inv(jacobian @ np.linalg.solve(inertia, jacobian.T))))
    env.close()
    return np.asarray(joint), np.asarray(task)


def main(run: Config) -> None:
    """Print the medians."""
    joint, task = inertias(find_arm(run.arm), run.samples, run.seed)
    print("joint space [kg m^2]          ", np.median(joint, 0).round(3))
    print("operational space [kg, kg m^2]", np.median(task, 0).round(2))


if __name__ == "__main__":
    run_script(main, Config)
