"""PPT in mazes of sharp turns and high friction: the policy decides on a velocity, and remembers how it got stuck.

The tool sticks where it runs into a wall, and what frees it has to be learnt. Trains in mazes, other ones than those of
the test. With defaults, or look at the options: ``python recipes/ppo_ppt_sharp_maze.py --help``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from torch import nn
from torchrl.envs import Transform, TransformedEnv

from ppt_rl.envs import MazeEnv, MazeRanges, MazeRewards
from ppt_rl.evaluation import Recipe
from ppt_rl.modules import Kinematics, ProMP
from ppt_rl.tasks import damping_key, make_controller, motor_tank, wrench_law
from ppt_rl.tasks.maze import (
    MAZE,
    RecedingConfig,
    fit_maze_prior,
    make_maze_policy,
    make_maze_promp,
    maze_metrics,
    maze_space,
    velocity_map,
)
from ppt_rl.tasks.maze.config import TrainingGround
from ppt_rl.training import PPOConfig
from ppt_rl.transforms import (
    ActionMapTransform,
    ContactViaPointTransform,
    EnergyTankTransform,
    EpisodeMetricsTransform,
    HeadingFrameTransform,
    ImpedanceTransform,
    JointTorqueTransform,
    MacroStepTransform,
    MotionMemoryTransform,
    RecedingProMPTransform,
    ViaPointTransform,
)


def _ppo() -> PPOConfig:
    return PPOConfig(
        total_control_steps=6_000_000, epochs=6, minibatches=8, learning_rate=5e-4, max_learning_rate=1e-3, gamma=0.998
    )


def _rewards() -> MazeRewards:
    """Progress counts most: a tool that is stuck has to try something."""
    return MazeRewards(progress=15.0, success=10.0, free_space=3.0, cruise=0.085, contact=0.6, jolt=0.6, failure=10.0)


@dataclass(frozen=True)
class Config(RecedingConfig):
    """Train PPT (ProMP + PPO + energy tank) for mazes of sharp turns and high friction.

    The residuals are those of a weight at the end of the primitive: divided by its duration, a velocity. The policy
    does not decide on the height, since a tool that floats feels no friction.
    """

    run_dir: Path = Path("runs/ppt_sharp_maze")
    train_in: TrainingGround = "mazes"
    training_duration: float = 14.0
    physics_dt: float = 0.001
    follower_speed: float = 0.1
    follower_lead: float = 0.008
    residual_ahead: float = 0.04
    residual_left: float = 0.12
    residual_up: float = 0.0
    max_lead: float = 0.01
    initial_scale: float = 0.3
    batch_steps: int = 60
    mazes: MazeRanges = field(default_factory=lambda: MazeRanges(turn=(1.2915, 1.2915), friction=(0.6, 1.0)))
    rewards: MazeRewards = field(default_factory=_rewards)
    ppo: PPOConfig = field(default_factory=_ppo)


def make_modules(config: Config) -> dict[str, ProMP]:
    """The movement primitive, its prior not fitted yet: what a checkpoint holds besides the networks."""
    return {"promp": make_maze_promp(config)}


def make_chain(config: Config, base: MazeEnv, promp: ProMP) -> list[Transform]:
    """PPT's chain in the maze, with a memory of the motion; what stands above the macro step runs at control rate."""
    kinematics = Kinematics(base.arm, base.tool_length)
    mode, damping = config.tank_mode, damping_key(config.tank_mode)
    return [
        motor_tank(config.p_max, config.e_max, mode, base.arm),
        JointTorqueTransform(kinematics, posture_stiffness=config.posture_stiffness, damping_key=damping),
        EnergyTankTransform(config.p_max, config.e_max, flow_key="twist", **wrench_law(mode, base.arm)),
        ImpedanceTransform(make_controller(config), damping_key=damping),
        EpisodeMetricsTransform(maze_metrics(config)),
        HeadingFrameTransform(),
        MotionMemoryTransform(),
        ContactViaPointTransform(config.promp_duration),
        MacroStepTransform(
            config.replan_steps,
            discount=config.ppo.gamma,
            interrupt_key="new_wall" if config.replan_on_contact else None,
        ),
        RecedingProMPTransform(
            promp,
            maze_space(),
            residual_scale=config.residual_scale,
            max_lead=(config.max_lead, 0.001, 0.0),
            max_slip=config.max_slip,
            replan_steps=config.replan_steps,
        ),
        ViaPointTransform(promp, frame=("pose", "heading")),
        ActionMapTransform(velocity_map(promp)),
    ]


def make_policy(config: Config, env: TransformedEnv) -> tuple[nn.Module, nn.Module]:
    """Actor and critic."""
    return make_maze_policy(
        env,
        initial_scale=config.initial_scale,
        extra_keys=("contact", "tank_energy", "valve"),
        vector_keys=("heading_creep", "heading_course"),
    )


def fit(config: Config, promp: ProMP) -> None:
    """Fit the prior to rollouts of the wall follower in straight corridors."""
    fit_maze_prior(promp, config)


RECIPE = Recipe(
    "ppt_sharp_maze", "PPT, sharp maze", MAZE, Config, make_chain, make_policy, make_modules, fit,
    has_tank=True, has_reference=True, in_study=False, trace=("via_position", "via_mask"),
)  # fmt: skip

if __name__ == "__main__":
    RECIPE.main()
