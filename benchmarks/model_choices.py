"""The effect of two modelling choices: the friction cone, and the inertia in the nullspace projection.

The via-point reference pushes boxes without a policy. docs/method.md quotes the figures.
``python benchmarks/model_choices.py``
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torchrl.envs import TransformedEnv

from ppt_rl.envs.mujoco_imports import mujoco
from ppt_rl.evaluation import record_episodes
from ppt_rl.tasks.push import fit_push_prior
from ppt_rl.training import run_cli
from ppt_rl.transforms import JointTorqueTransform

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "recipes"))

_CONES = {"elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC, "pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL}


@dataclass(frozen=True)
class Config:
    """Run the reference alone with each friction cone and each projection.

    Attributes:
        episodes: number of episodes for each choice.
        num_threads: physics threads; 0 takes one for each CPU.
        seed: seed of the episodes.
        box_yaw: largest yaw of the box relative to the table's axes [rad].
    """

    episodes: int = 256
    num_threads: int = 0
    seed: int = 0
    box_yaw: float = 0.2


def reference_env(run: Config, promp: Any) -> TransformedEnv:
    """The environment with PPT's chain."""
    import ppo_ppt_push as recipe

    config = replace(recipe.Config(), num_envs=run.episodes, num_threads=run.num_threads)
    env = recipe.make_env(config, promp, seed=run.seed)
    base = env.base_env
    base.randomisation = replace(base.randomisation, box_yaw=(-run.box_yaw, run.box_yaw))
    return env


def main(run: Config) -> None:
    """Measure both choices and print the figures."""
    import ppo_ppt_push as recipe

    promp = fit_push_prior(recipe.make_modules(recipe.Config())["promp"])

    def still(tensordict: Any) -> Any:
        return tensordict.set("action", torch.zeros(run.episodes, promp.num_basis * promp.num_dof))

    for name, cone in _CONES.items():
        env = reference_env(run, promp)
        for model in env.base_env.engine.models:
            model.opt.cone = int(cone)
        episode = record_episodes(env, still, ["box_pose"])
        way = episode["goal"] - episode["box_start"]
        normal = torch.stack([-way[:, 1], way[:, 0]], -1) / way.norm(dim=-1, keepdim=True)
        offset = ((episode["trace", "box_pose"][:, -1, :2] - episode["goal"]) * normal).sum(-1)
        print(
            f"{name:>10} cone: success {episode['success'].float().mean():.3f}, box ends "
            f"{1e3 * offset.square().mean().sqrt():.1f} mm RMS beside the line to its goal"
        )
        env.close()
    for name in ("joint inertia", "identity"):
        env = reference_env(run, promp)
        torque = next(part for part in env.transform if isinstance(part, JointTorqueTransform))
        if name == "identity":
            torque.joint_inertia.fill_(1.0)
        height = record_episodes(env, still, ["pose"])["trace", "pose"][..., 2]
        drop = (height - height[:, :1]).abs().amax(-1)
        print(
            f"projection with {name:>13}: tool leaves its height by up to {1e3 * drop.mean():.1f} mm (mean of episodes)"
        )
        env.close()


if __name__ == "__main__":
    torch.set_num_threads(1)
    run_cli(main, Config)
