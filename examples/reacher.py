"""A ProMP policy behind an energy tank on other people's environments: ``python examples/reacher.py [dm_control|gym]``.

Both robots have two joints. An action of 1 is ``gear`` newton metres, so limits in watts and joules are divided by it.

A minute of training is short. Mean returns of 80 episodes before and after it (seed 0): -12.7 and -8.8 on Gymnasium's
``Reacher-v5``, where random residuals get -12.5. On dm_control's ``reacher-easy`` they are 1.3 and 3.7, but random
residuals get 5.1: its reward is sparse, and a minute is not enough.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.collectors import Collector
from torchrl.envs import (
    Compose,
    DMControlEnv,
    DoubleToFloat,
    EnvBase,
    GymEnv,
    RenameTransform,
    SerialEnv,
    Transform,
    TransformedEnv,
    UnaryTransform,
    set_exploration_type,
)
from torchrl.envs.utils import ExplorationType

from ppt_rl.modules import JointSpace, ProMP, update_input_norm
from ppt_rl.training import PPOConfig, begin_norms, make_actor_critic
from ppt_rl.training.ppo import Learner
from ppt_rl.transforms import EnergyTankTransform, MacroStepTransform, PDTrackingTransform, ProMPTransform

BASIS = 4


@dataclass(frozen=True)
class Reacher:
    """One of the two environments, with what its chain needs to know about it.

    Attributes:
        make: one environment.
        names: transforms that write ``joint_position`` and ``joint_velocity`` from its observations.
        reads: observations of the policy besides the state of the reference.
        dt: control step [s].
        duration: length of an episode [s].
        gear: effort of an action of 1 [N m].
        stiffness: of each joint [actions/rad].
        damping: of each joint [actions s/rad].
        p_max: power limit [W].
        e_max: energy of an episode [J].
        control_steps: budget of a training of about a minute.
    """

    make: Callable[[], EnvBase]
    names: Callable[[], Sequence[Transform]]
    reads: tuple[str, ...]
    dt: float
    duration: float
    gear: float
    stiffness: tuple[float, float]
    damping: tuple[float, float]
    p_max: float
    e_max: float
    control_steps: int


def angles(observation: Tensor) -> Tensor:
    """Joint positions from Gymnasium's cosines and sines, known up to whole turns."""
    return torch.atan2(observation[..., 2:4], observation[..., :2])


def rates(observation: Tensor) -> Tensor:
    """Joint velocities from Gymnasium's observation."""
    return observation[..., 6:8]


def standing(joint_position: Tensor) -> Tensor:
    """Weights of a primitive that stands still: a residual then says how far to move from here."""
    return joint_position.unsqueeze(-2).expand(*joint_position.shape[:-1], BASIS, joint_position.shape[-1]).clone()


REACHERS = {
    "dm_control": Reacher(
        lambda: DMControlEnv("reacher", "easy", time_limit=2.0),
        lambda: [RenameTransform(["position", "velocity"], ["joint_position", "joint_velocity"])],
        ("to_target",), dt=0.02, duration=2.0, gear=0.05, stiffness=(4.0, 1.0), damping=(0.6, 0.05), p_max=0.2,
        e_max=0.3, control_steps=60_000,
    ),
    "gym": Reacher(
        lambda: GymEnv("Reacher-v5"),
        lambda: [
            UnaryTransform(["observation"], ["joint_position"], fn=angles),
            UnaryTransform(["observation"], ["joint_velocity"], fn=rates),
        ],
        ("observation",), dt=0.02, duration=1.0, gear=200.0, stiffness=(1.1, 1.1), damping=(0.15, 0.15), p_max=40.0,
        e_max=20.0, control_steps=60_000,
    ),
}  # fmt: skip


def make_chain(reacher: Reacher) -> list[Transform]:
    """The method as a list: what stands above the macro step runs at control rate, the tank next to the environment."""
    promp = ProMP(num_basis=BASIS, num_dof=2, duration=reacher.duration)
    joints, replan = JointSpace(2, continuous=(0,)), round(0.2 * reacher.duration / reacher.dt)
    return [
        DoubleToFloat(),
        *reacher.names(),  # observations -> joint_position, joint_velocity
        EnergyTankTransform(reacher.p_max / reacher.gear, reacher.e_max / reacher.gear, dt=reacher.dt),
        PDTrackingTransform(reacher.stiffness, reacher.damping, continuous=(0,)),  # reference -> effort
        MacroStepTransform(replan),  # one policy step = a fifth of an episode
        ProMPTransform(
            promp, joints, residual_scale=1.5, replan_steps=replan, dt=reacher.dt, pose_key="joint_position"
        ),  # residual -> references
        UnaryTransform(["joint_position"], ["weights_mean"], fn=standing),
    ]


def make_env(reacher: Reacher, num_envs: int, seed: int) -> TransformedEnv:
    """Environments with the chain outside, so that its tensors hold all of them."""
    env = TransformedEnv(SerialEnv(num_envs, reacher.make), Compose(*make_chain(reacher)))
    env.set_seed(seed)
    return env


def make_policy(reacher: Reacher, env: TransformedEnv) -> tuple[nn.Module, nn.Module]:
    """Actor and critic on the joints, the target, the phase and the tank."""
    keys = ("joint_position", "joint_velocity", *reacher.reads, "reference_position", "phase", "tank_energy")
    return make_actor_critic(env, keys, keys, initial_scale=1.0)


def train(reacher: Reacher, control_steps: int | None = None, num_envs: int = 16, seed: int = 0) -> nn.Module:
    """Train with PPO until the budget is spent and return the actor."""
    torch.manual_seed(seed)
    env = make_env(reacher, num_envs, seed)
    actor, critic = make_policy(reacher, env)
    begin_norms(env, [actor, critic], resets=1)
    budget = reacher.control_steps if control_steps is None else control_steps
    learner = Learner(
        actor, critic, PPOConfig(gamma=0.999, gae_lambda=0.8, epochs=10, target_kl=0.05, learning_rate=1e-3)
    )
    collector = Collector(
        env, actor, frames_per_batch=10 * num_envs, total_frames=-1, auto_register_policy_transforms=False
    )
    for batch in collector:
        learner.update(batch)
        for module in (actor, critic):
            update_input_norm(module, batch)
        budget -= int(batch["next", "control_steps"].sum())
        if budget <= 0:
            break
    collector.shutdown()
    return actor


def returns(reacher: Reacher, actor: nn.Module | None, seed: int, episodes: int = 16) -> Tensor:
    """Returns of whole episodes with the mean action; without an actor, of random residuals."""
    env = make_env(reacher, episodes, seed)
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        reward: TensorDictBase = env.rollout(5, actor)["next", "reward"]
    env.close()
    return reward.sum((1, 2))


def main(name: str) -> None:
    """Train on one of the environments and print the mean return over five seeds before and after."""
    reacher = REACHERS[name]
    untrained = make_policy(reacher, make_env(reacher, 1, 0))[0]
    started = time.perf_counter()
    actor = train(reacher)
    print(f"{name}: {reacher.control_steps} control steps in {time.perf_counter() - started:.0f} s")
    for label, policy in (("random residuals", None), ("untrained mean", untrained), ("trained mean", actor)):
        means = torch.stack([returns(reacher, policy, 1000 + 100 * seed).mean() for seed in range(5)])
        print(f"  {label:17s} return {means.mean():8.2f}  (seeds {means.min():.2f} to {means.max():.2f})")


if __name__ == "__main__":
    for chosen in sys.argv[1:] or REACHERS:
        main(chosen)
