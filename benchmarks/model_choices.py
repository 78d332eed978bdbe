"""What two choices of the model change: the friction cone, and the inertia in the nullspace projection.

The reference alone (no policy) pushes boxes; both figures are quoted in docs/method.md.
``python benchmarks/model_choices.py``
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import torch
from torchrl.envs import TransformedEnv

from ppt_rl.envs.mujoco_imports import mujoco
from ppt_rl.evaluation import record_episodes
from ppt_rl.recipes.ppo_ppt_push import RECIPE
from ppt_rl.tasks.push import fit_push_prior
from ppt_rl.training import run_script
from ppt_rl.transforms import JointTorqueTransform

_CONES = {"elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC, "pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL}


@dataclass(frozen=True)
class Config:
    """Run the reference alone with each friction cone and each projection.

    Attributes:
        episodes: episodes of each kind.
        num_threads: physics threads; 0 takes one per CPU.
        seed: of the episodes.
        box_yaw: largest yaw of the box off the table's axes [rad].
    """

    episodes: int = 256
    num_threads: int = 0
    seed: int = 0
    box_yaw: float = 0.2


def reference_env(run: Config, promp: Any) -> TransformedEnv:
    """PPT's chain in fresh episodes."""
    config = RECIPE.config(goal="position", num_basis=8, num_threads=run.num_threads)
    env = RECIPE.make_env(config, {"promp": promp}, num_envs=run.episodes, seed=run.seed)
    base = env.base_env
    base.randomisation = replace(base.randomisation, box_yaw=(-run.box_yaw, run.box_yaw))
    return env


def main(run: Config) -> None:
    """Measure and print."""
    promp = fit_push_prior(RECIPE.make_modules(RECIPE.config(goal="position", num_basis=8))["promp"])

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
            f"{name:>10} cone: success {episode['success'].float().mean():.3f}, box off the line to its goal by "
            f"{1e3 * offset.square().mean().sqrt():.1f} mm RMS"
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
            f"projection with {name:>13}: tool off its height by up to {1e3 * drop.mean():.1f} mm (mean over episodes)"
        )
        env.close()


if __name__ == "__main__":
    torch.set_num_threads(1)
    run_script(main, Config)
