"""The smallest task: the tool reaches a point over the table. ``ppt-rl train examples/reach/ppo_ppt_reach.py``.

It shows every part that a task needs and no more. Behind its tank of 2 W and 1 J, the reference alone is too slow for
the farther points: half a minute of learning shows that training works, not more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torchrl.data import Composite
from torchrl.envs import Transform, TransformedEnv

from ppt_rl.envs import ArmEnv
from ppt_rl.envs.rewards import reward_spec, total_reward, work_penalty, zero_rewards
from ppt_rl.envs.specs import SpecMaker
from ppt_rl.evaluation import Recipe, Task
from ppt_rl.modules import Kinematics, ProMP, TaskSpace
from ppt_rl.tasks import TaskConfig, env_settings, episode_metrics, make_controller
from ppt_rl.tasks.push.prior import push_demonstrations
from ppt_rl.training import make_actor_critic
from ppt_rl.transforms import (
    EnergyTankTransform,
    EpisodeMetricsTransform,
    ImpedanceTransform,
    JointTorqueTransform,
    MacroStepTransform,
    ProMPTransform,
    ViaPointTransform,
)

GROUPS = ("progress", "power")  # names of the rewards


class ReachEnv(ArmEnv):
    """Reach a point (x, y) at the height of the start; success: within 1 cm at the end."""

    horizon_terminates = True  # success is judged at the horizon, so nothing is bootstrapped beyond it

    def _prepare(self, model: Any) -> None:
        """Allocate the state of the episodes."""
        self._start = torch.tensor(self.start_pose[:2], device=self.place)
        self._goal = torch.zeros(self.num_envs, 2, device=self.place)
        self._first = torch.ones(self.num_envs, 1, device=self.place)

    def _begin(self, rows: Tensor) -> Tensor:
        """Draw episodes; the arm starts where every arm does."""
        drawn = self._generators.uniform(rows, 2)  # (R, 2) in [0, 1), from each environment's own generator
        self._goal[rows] = (drawn.new_tensor([0.5, -0.15]) + drawn.new_tensor([0.15, 0.3]) * drawn).to(self.dtype)
        return super()._begin(rows)

    def _task_reset(self, rows: Tensor) -> dict[str, Any]:
        self._first[rows] = (self._goal - self._start).norm(dim=-1, keepdim=True)[rows]
        zeros = zero_rewards(self.num_envs, self.dtype, GROUPS, device=self.place)
        return self._observe(self._first, zeros, self._elapsed < 0)

    def _task_step(self, observation: dict[str, Any], ended: Tensor) -> dict[str, Any]:
        distance = (observation["pose"][:, :2] - self._goal).norm(dim=-1, keepdim=True)  # [m]
        success = ended & (distance < 0.01)
        terms = {
            "progress": -10 * distance * ended + success.to(self.dtype),
            "power": work_penalty(0.1, wrench=observation["wrench"], twist=observation["twist"], dt=self.control_dt),
        }
        return self._observe(distance, terms, success) | {"reward": total_reward(terms)}

    def _observe(self, distance: Tensor, terms: dict[str, Tensor], success: Tensor) -> dict[str, Any]:
        like = self._goal
        return {
            "goal": like.clone(),
            "via_phase": like.new_tensor([0.0, 0.9]).repeat(self.num_envs, 1),
            "via_position": torch.stack([self._start.expand_as(like), like], 1),  # (num_envs, 2 points, 2 coordinates)
            "via_cov": (1e-6 * torch.eye(2, device=self.place)).repeat(self.num_envs, 2, 1, 1),
            "progress": (1 - distance / self._first).clamp(0.0, 1.0),
            "success": success,
            "reward_terms": terms,
        }

    def _task_spec(self, make: SpecMaker) -> Composite:
        return make.nest(
            goal=make.real(2), via_phase=make.real(2), via_position=make.real(2, 2), via_cov=make.real(2, 2, 2),
            progress=make.real(1), success=make.flag(), reward_terms=reward_spec(make, GROUPS),
        )  # fmt: skip


@dataclass(frozen=True)
class Config(TaskConfig):
    """Train PPT on reaching.

    Attributes:
        e_max: capacity of the tank [J].
        num_basis: number of basis functions for x and for y.
    """

    run_dir: Path = Path("runs/ppt_reach")
    num_envs: int = 32
    duration: float = 1.5
    e_max: float = 1.0
    num_basis: int = 6

    @property
    def batch_steps(self) -> int:
        """Policy steps of every environment in a batch: one episode, decided once."""
        return 1


def make_env(
    config: Config, *, num_envs: int, seed: int | None = None, audit: bool = False, given: Sequence[Any] = ()
) -> ReachEnv:
    """The bare environment, the same in training and test."""
    return ReachEnv(duration=config.duration, **env_settings(config, num_envs=num_envs, seed=seed, audit=audit))


def make_modules(config: Config) -> dict[str, ProMP]:
    """The movement primitive, its prior not fitted yet."""
    return {"promp": ProMP(config.num_basis, 2, config.duration)}


def fit(config: Config, promp: ProMP) -> None:
    """Fit the prior to scripted motions from the start to random goals."""
    env = make_env(config, num_envs=256, seed=0)
    episode = env.reset()
    promp.fit(push_demonstrations(episode["via_phase"].double(), episode["via_position"].double()))
    env.close()


def make_chain(config: Config, base: ReachEnv, promp: ProMP) -> list[Transform]:
    """The method as a list: what stands above the macro step runs at control rate."""
    return [
        EnergyTankTransform(config.p_max, config.e_max),  # at the motors: torque and joint velocity
        JointTorqueTransform(Kinematics(base.arm, base.tool_length)),
        ImpedanceTransform(make_controller(config)),
        EpisodeMetricsTransform(episode_metrics(config)),
        MacroStepTransform(config.horizon),  # the whole episode; films and recordings need the number
        ProMPTransform(promp, TaskSpace(("x", "y"), base.start_pose)),
        ViaPointTransform(promp),
    ]


def make_policy(config: Config, env: TransformedEnv) -> tuple[nn.Module, nn.Module]:
    """Actor and critic on what is known before the motion."""
    return make_actor_critic(env, ("goal", "pose"), ("goal", "pose"), initial_scale=0.3)


REACH = Task("reach", make_training_env=make_env, make_test_env=make_env)
RECIPE = Recipe(
    "ppt_reach", "PPT", REACH, Config, make_chain, make_policy, make_modules, fit, has_tank=True, has_reference=True
)

if __name__ == "__main__":
    RECIPE.main()
