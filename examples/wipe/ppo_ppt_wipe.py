"""PPT on wiping, a task of its own: ``ppt-rl train examples/wipe/ppo_ppt_wipe.py``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import nn
from torchrl.envs import Transform, TransformedEnv
from wipe_env import STIFFNESS, WipeEnv

from ppt_rl.evaluation import Policy, Recipe, Task
from ppt_rl.modules import Kinematics, ProMP, TaskSpace
from ppt_rl.tasks import TaskConfig, env_settings, episode_metrics, make_controller, motor_tank
from ppt_rl.tasks.push.prior import push_demonstrations
from ppt_rl.training import PPOConfig, make_actor_critic
from ppt_rl.transforms import (
    EnergyTankTransform,
    EpisodeMetricsTransform,
    ImpedanceTransform,
    JointTorqueTransform,
    MacroStepTransform,
    ProMPTransform,
    ViaPointTransform,
)

AXES = ("x", "y", "z")
#: What the policy reads, and what the critic reads besides.
KNOWN = ("line", "wanted_force", "pose", "wrench", "reference_position", "phase", "tank_energy", "valve")
PRIVILEGED = ("board",)


@dataclass(frozen=True)
class Config(TaskConfig):
    """Train PPT (ProMP + PPO + energy tank) on wiping.

    Attributes:
        e_max: capacity of the tank [J].
        num_basis: number of basis functions of the ProMP for each of x, y and z.
        replan_steps: control steps from one policy step to the next; the policy feels the board at each.
        residual_scale: change of a weight in x, y and z per unit of residual [m].
        initial_scale: standard deviation of the untrained policy, in residuals [-].
    """

    run_dir: Path = Path("runs/ppt_wipe")
    num_envs: int = 32
    e_max: float = 1.5
    num_basis: int = 8
    replan_steps: int = 60
    residual_scale: tuple[float, ...] = (0.005, 0.005, 0.01)
    initial_scale: float = 0.25
    ppo: PPOConfig = field(default_factory=lambda: PPOConfig(total_control_steps=1_000_000, gamma=0.99, target_kl=0.05))

    @property
    def batch_steps(self) -> int:
        """Policy steps of every environment in a batch: those of an episode."""
        return -(-self.horizon // self.replan_steps)


def make_env(
    config: Config, *, num_envs: int, seed: int | None = None, audit: bool = False, given: Sequence[Any] = ()
) -> WipeEnv:
    """The bare environment, the same in training and test."""
    return WipeEnv(duration=config.duration, **env_settings(config, num_envs=num_envs, seed=seed, audit=audit))


def make_modules(config: Config) -> dict[str, ProMP]:
    """The movement primitive, its prior not fitted yet."""
    return {"promp": ProMP(config.num_basis, len(AXES), config.duration)}


def fit(config: Config, promp: ProMP) -> None:
    """Fit the prior to scripted wipes of random episodes."""
    env = make_env(config, num_envs=512, seed=0)
    episode = env.reset()
    promp.fit(push_demonstrations(episode["via_phase"].double(), episode["via_position"].double()))
    env.close()


def make_chain(config: Config, base: WipeEnv, promp: ProMP) -> list[Transform]:
    """PPT's chain: what stands above the macro step runs at control rate."""
    space = TaskSpace(AXES, base.start_pose)
    return [
        motor_tank(config.p_max, config.e_max),
        JointTorqueTransform(Kinematics(base.arm, base.tool_length)),
        EnergyTankTransform(config.p_max, config.e_max, flow_key="twist"),
        ImpedanceTransform(make_controller(config)),
        EpisodeMetricsTransform(episode_metrics(config)),
        MacroStepTransform(config.replan_steps, discount=config.ppo.gamma),
        ProMPTransform(promp, space, residual_scale=config.residual_scale, replan_steps=config.replan_steps),
        ViaPointTransform(promp),
    ]


def make_policy(config: Config, env: TransformedEnv) -> tuple[nn.Module, nn.Module]:
    """Actor on what is felt and known, critic on the board as well."""
    return make_actor_critic(env, KNOWN, (*KNOWN, *PRIVILEGED), initial_scale=config.initial_scale)


def force_feedback(policy: Policy, base: WipeEnv) -> tuple[TransformedEnv, Any]:
    """A scripted controller: each policy step shifts the reference's height by the force error over the stiffness."""

    def act(tensordict: TensorDictBase) -> TensorDictBase:
        press, reference = -tensordict["wrench"][:, 2:3], tensordict["reference_position"][:, 2:3]
        shift = reference + (press - tensordict["wanted_force"]) / STIFFNESS - tensordict["via_position"][:, 1, 2:3]
        touching = (press > 0.3) & (tensordict["phase"] > 0.25)  # [N], [-]
        weights = (shift * touching / policy.config.residual_scale[2]).expand(-1, policy.config.num_basis)
        zeros = torch.zeros_like(weights)  # of x and y: weights are ordered column by column
        return tensordict.set("action", torch.cat([zeros, zeros, weights], -1))

    return policy.recipe.on(base, policy.config, policy.modules), act


def random_policy(policy: Policy, base: WipeEnv) -> tuple[TransformedEnv, Any]:
    """Residuals drawn as the untrained policy draws them."""
    env = policy.recipe.on(base, policy.config, policy.modules)
    action = env.full_action_spec["action"].zero()
    return env, lambda tensordict: tensordict.set("action", policy.config.initial_scale * torch.randn_like(action))


BASELINES = {"force feedback": force_feedback, "random policy": random_policy}
WIPE = Task("wipe", make_training_env=make_env, make_test_env=make_env, privileged=PRIVILEGED, baselines=BASELINES)
RECIPE = Recipe(
    "ppt_wipe", "PPT", WIPE, Config, make_chain, make_policy, make_modules, fit, has_tank=True, has_reference=True
)

if __name__ == "__main__":
    RECIPE.main()
