"""PPT on box pushing: ProMP residual policy, energy tank, Cartesian impedance.

Train with defaults, or look at the options: ``python recipes/ppo_ppt_push.py --help``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import torch
from torch import nn
from torchrl.envs import Compose, TransformedEnv

from ppt_rl.envs import PandaPushEnv
from ppt_rl.functional import MetricsConfig
from ppt_rl.modules import CartesianImpedanceController, PandaKinematics, ProMP, TaskSpace
from ppt_rl.training import PUSH_AXES, PPOConfig, fit_push_prior, make_actor_critic, run_recipe
from ppt_rl.transforms import (
    EnergyTankTransform,
    EpisodeMetricsTransform,
    ImpedanceTransform,
    JointTorqueTransform,
    MacroStepTransform,
    ProMPTransform,
    ViaPointTransform,
)

VARIANT = "ppt_push"


@dataclass(frozen=True)
class Config:
    """Train PPT (ProMP + PPO + energy tank) on box pushing.

    Attributes:
        run_dir: where logs, checkpoints and figures go.
        seed: of everything random.
        resume: go on from the newest checkpoint in run_dir.
        num_envs: environments that step together.
        num_threads: physics threads; 0 takes one per CPU.
        torch_threads: threads of torch; its tensors are small here, more than one gains nothing.
        duration: episode length [s].
        physics_dt: time step of the physics [s].
        control_dt: time step of the controller [s].
        box_sizes: edges of the boxes to draw from [m]: 0.06 (50 g), 0.08 (80 g).
        num_basis: basis functions of the ProMP for each of x, y and yaw.
        replan_steps: control steps between policy steps; 0 is one policy step per episode.
        residual_position: how far a residual of 1 moves a weight in x and y [m].
        residual_yaw: how far a residual of 1 moves a weight in yaw [rad].
        stiffness: linear stiffness of the impedance [N/m].
        damping_ratio: of the impedance [-].
        p_max: power limit of the tank [W].
        e_max: capacity of the tank [J].
        initial_scale: standard deviation of the untrained policy, in residuals [-].
        ppo: settings of PPO.
    """

    run_dir: Path = Path("runs/ppt_push")
    seed: int = 0
    resume: bool = False
    num_envs: int = 128
    num_threads: int = 0
    torch_threads: int = 1
    duration: float = 3.0
    physics_dt: float = 0.0005
    control_dt: float = 0.01
    box_sizes: tuple[float, ...] = (0.06, 0.08)
    num_basis: int = 8
    replan_steps: int = 0
    residual_position: float = 0.03
    residual_yaw: float = 0.3
    stiffness: float = 400.0
    damping_ratio: float = 1.0
    p_max: float = 2.0
    e_max: float = 3.0
    initial_scale: float = 0.25
    ppo: PPOConfig = field(default_factory=PPOConfig)


def blank_promp(config: Config) -> ProMP:
    """The movement primitive before its prior is fitted, or loaded."""
    return ProMP(config.num_basis, len(PUSH_AXES), config.duration)


def make_env(
    config: Config, promp: ProMP, *, num_envs: int | None = None, seed: int | None = None, trace: tuple[str, ...] = ()
) -> TransformedEnv:
    """The pushing environment with PPT's chain: what stands above the macro step runs at control rate."""
    base = PandaPushEnv(
        num_envs=num_envs or config.num_envs,
        box_sizes=config.box_sizes,
        duration=config.duration,
        physics_dt=config.physics_dt,
        control_dt=config.control_dt,
        num_threads=config.num_threads or None,
        seed=config.seed if seed is None else seed,
    )
    dt = config.control_dt
    linear = (config.stiffness,) * 3
    controller = CartesianImpedanceController((*linear, 30.0, 30.0, 30.0), config.damping_ratio)
    residual = (config.residual_position, config.residual_position, config.residual_yaw)
    replan = config.replan_steps or base.horizon
    return TransformedEnv(
        base,
        Compose(
            JointTorqueTransform(PandaKinematics(base.tool_length), dt=dt),
            EnergyTankTransform(p_max=config.p_max, e_max=config.e_max, dt=dt),
            ImpedanceTransform(controller),
            EpisodeMetricsTransform(MetricsConfig(dt=dt, p_max=config.p_max)),
            MacroStepTransform(replan, discount=config.ppo.gamma, trace_keys=trace),
            ProMPTransform(
                promp, TaskSpace(PUSH_AXES, base.start_pose), residual_scale=residual, replan_steps=replan, dt=dt
            ),
            ViaPointTransform(promp),
        ),
    )


def make_policy(config: Config, env: TransformedEnv) -> tuple[nn.Module, nn.Module]:
    """Actor on what is known at test time; the critic, needed in training only, sees the box as well."""
    known = ["box_start", "goal", "box_size", "pose", "twist", "wrench", "phase", "tank_energy", "valve"]
    return make_actor_critic(env, known, [*known, "box_pose"], initial_scale=config.initial_scale)


def main(config: Config) -> Path:
    """Train."""
    torch.set_num_threads(config.torch_threads)
    torch.manual_seed(config.seed)
    promp = fit_push_prior(blank_promp(config))  # from scripted demonstrations
    env = make_env(config, promp)
    actor, critic = make_policy(config, env)
    policy_steps = -(-env.base_env.horizon // (config.replan_steps or env.base_env.horizon))
    return run_recipe(VARIANT, config, env, actor, critic, policy_steps=policy_steps, extra={"promp": promp})


if __name__ == "__main__":
    from ppt_rl.training import run_cli

    run_cli(main, Config)
