"""What the pushing recipes have in common: options, environment and networks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, get_args

from ppt_rl.envs import PushEnv, PushGoal, PushRandomisation, PushReference
from ppt_rl.envs.push import Obstacle, ObstructedPushEnv
from ppt_rl.functional.argument_checks import shown
from ppt_rl.functional.checks import Bounds
from ppt_rl.tasks.config import TaskConfig, env_settings
from ppt_rl.training import PPOConfig

__all__ = [
    "ByGoal",
    "EpisodeLevelConfig",
    "PushConfig",
    "StepWiseConfig",
    "make_push_env",
]

if TYPE_CHECKING:
    ByGoal = float
else:  # a number that __post_init__ fills in where it is None
    ByGoal = float | None
#: Defaults that depend on what has to be at the goal.
_BY_GOAL = {
    "duration": {"pose": 1.5, "position": 3.0},
    "e_max": {"pose": 1.3, "position": 3.0},
    "energy_penalty": {"pose": 0.5, "position": 0.0},
    "max_velocity": {"pose": 0.4, "position": 0.2},
}


def _ppo() -> PPOConfig:
    return PPOConfig(total_control_steps=2_208_000, epochs=12, target_kl=0.03)


@dataclass(frozen=True)
class PushConfig(TaskConfig):
    """Options of every pushing recipe.

    Attributes:
        goal: what has to be at the goal: the centre of the box (the paper's task), or its yaw as well.
        duration: episode length [s]; None takes that of the goal: 1.5 s for a pose, 3 s for a position.
        mirror: whether actor and task share the mirror symmetry of left and right.
        counter_turn: share of the missing turn by which the reference approaches from the other side [-].
        box_sizes: edge lengths of the boxes to draw from [m].
        box_masses: mass of each of them [kg]; none takes the paper's, which has 0.06 m (50 g) and 0.08 m (80 g).
        randomisation: ranges of what is drawn for each episode; wider ones make the task harder.
    """

    run_dir: Path = Path("runs/push")
    goal: PushGoal = "pose"
    duration: ByGoal = None  # type: ignore[assignment]
    mirror: bool = True
    counter_turn: float = 0.5
    box_sizes: tuple[float, ...] = (0.06, 0.08)
    box_masses: tuple[float, ...] = ()
    randomisation: PushRandomisation = field(default_factory=PushRandomisation)
    validate_every: int = 14
    ppo: PPOConfig = field(default_factory=_ppo)

    bounds: ClassVar[dict[str, Bounds]] = {"box_sizes": Bounds(1e-3, 1.0, "m"), "counter_turn": Bounds(-3.0, 3.0)}

    def __post_init__(self) -> None:
        """Take the defaults of the goal, and refuse numbers out of bounds."""
        if self.goal not in get_args(PushGoal):
            raise ValueError(f"goal is {shown(self.goal)}; expected one of {list(get_args(PushGoal))}.")
        for name, default in _BY_GOAL.items():
            if getattr(self, name, 0.0) is None:
                object.__setattr__(self, name, default[self.goal])
        super().__post_init__()

    def implied(self, changes: Mapping[str, Any]) -> dict[str, Any]:
        """Where the goal changes, what has its default takes that of the new goal."""
        if changes.get("goal", self.goal) == self.goal:
            return {}
        return {name: None for name, default in _BY_GOAL.items() if getattr(self, name, None) == default[self.goal]}


@dataclass(frozen=True)
class EpisodeLevelConfig(PushConfig):
    """Options of the recipes whose policy acts on ProMP weights.

    Attributes:
        num_basis: number of basis functions of the ProMP for each of x, y and yaw.
        replan_steps: control steps from one policy step to the next; 0 means one policy step per episode.
        residual_position: change of a weight in x and y per unit of residual [m].
        residual_yaw: change of a weight in yaw per unit of residual [rad].
        initial_scale: standard deviation of the untrained policy, in residuals [-].
    """

    num_basis: int = 6
    replan_steps: int = 0
    residual_position: float = 0.05
    residual_yaw: float = 0.4
    initial_scale: float = 0.3

    # A GPU takes little longer for thousands of episodes than for hundreds, so what counts is the number of updates. An
    # episode is one policy step: that many give a good gradient, and each update may go far (results/gpu/README.md).
    presets: ClassVar[dict[str, dict[str, str]]] = {
        "gpu": {
            "device": "cuda", "num_envs": "2048", "validate_every": "2", "validation_episodes": "512",
            "ppo.epochs": "12", "ppo.minibatches": "8", "ppo.clip": "0.4", "ppo.target_kl": "0.6",
            "ppo.learning_rate": "2e-3", "ppo.max_learning_rate": "1e-2", "ppo.total_control_steps": "3686400",
        }
    }  # fmt: skip

    bounds: ClassVar[dict[str, Bounds]] = {
        "residual_position": Bounds(0.0, 10.0, "m"),
        "residual_yaw": Bounds(0.0, 10.0, "rad"),
    }

    @property
    def chunk(self) -> int:
        """Control steps of a policy step."""
        return self.replan_steps or self.horizon

    @property
    def batch_steps(self) -> int:
        """Policy steps of every environment in a batch: those of an episode."""
        return -(-self.horizon // self.chunk)

    @property
    def residual_scale(self) -> tuple[float, float, float]:
        """Change of a weight in x, y [m] and yaw [rad] per unit of residual."""
        return self.residual_position, self.residual_position, self.residual_yaw


@dataclass(frozen=True)
class StepWiseConfig(PushConfig):
    """Options of the recipes whose policy acts on Cartesian velocity.

    Attributes:
        max_velocity: velocity of an action of 1 in x and y [m/s]; None takes that of the goal: 0.4 m/s for a pose, 0.2
            m/s for a position.
        max_yaw_rate: yaw rate of an action of 1 [rad/s].
        max_lead: largest distance of the reference from the tool in x and y [m].
        max_yaw_lead: largest distance in yaw [rad].
        hold_steps: control steps from one decision to the next.
        smoothing: share of the difference to the last action that remains after a control step [-].
        on_reference: whether the velocity is added to that of the reference that PPT has, so that an action of zero
            follows it.
        num_basis: number of basis functions of that reference for each of x, y and yaw.
        initial_scale: standard deviation of the untrained policy, in actions [-].
    """

    hold_steps: int = 10
    smoothing: float = 0.8
    on_reference: bool = False
    num_basis: int = 6
    max_velocity: ByGoal = None  # type: ignore[assignment]
    max_yaw_rate: float = 1.5
    max_lead: float = 0.05
    max_yaw_lead: float = 0.3
    initial_scale: float = 0.5

    bounds: ClassVar[dict[str, Bounds]] = {
        "hold_steps": Bounds(1, 10_000, "control steps"),
        "smoothing": Bounds(0.0, 0.999),
        "max_velocity": Bounds(1e-6, 100.0, "m/s"),
        "max_yaw_rate": Bounds(1e-6, 100.0, "rad/s"),
        "max_lead": Bounds(1e-6, 10.0, "m"),
        "max_yaw_lead": Bounds(1e-6, 10.0, "rad"),
    }

    @property
    def batch_steps(self) -> int:
        """Policy steps of every environment in a batch: those of an episode."""
        return -(-self.horizon // self.hold_steps)

    @property
    def velocity(self) -> tuple[float, float, float]:
        """Velocity of an action of 1 in x, y [m/s] and yaw [rad/s]."""
        return self.max_velocity, self.max_velocity, self.max_yaw_rate

    @property
    def lead(self) -> tuple[float, float, float]:
        """Largest distance of the reference from the tool in x, y [m] and yaw [rad]."""
        return self.max_lead, self.max_lead, self.max_yaw_lead


def make_push_env(
    config: PushConfig, *, num_envs: int, seed: int | None = None, audit: bool = False, given: Sequence[Any] = (),
    obstacle: Obstacle | None = None,
) -> PushEnv:  # fmt: skip
    """The bare environment of a pushing recipe, the same in training and test.

    ``config``, ``num_envs``, ``seed`` and ``audit`` are those of :class:`~ppt_rl.evaluation.make_env.MakeEnv`;
    ``given`` must be empty, since pushing episodes are drawn. With an ``obstacle`` it is an
    :class:`~ppt_rl.envs.push.ObstructedPushEnv` with the same episodes.

    Raises:
        ValueError: if episodes are given.
    """
    if given:
        raise ValueError(f"{len(given)} episodes are given; expected none, since pushing episodes are drawn.")
    settings = env_settings(config, num_envs=num_envs, seed=seed, audit=audit)
    masses = config.box_masses or None
    reference = PushReference(counter_turn=config.counter_turn)
    settings |= {
        "goal": config.goal, "box_sizes": config.box_sizes, "box_masses": masses, "reference": reference,
        "randomisation": config.randomisation, "duration": config.duration,
    }  # fmt: skip
    return PushEnv(**settings) if obstacle is None else ObstructedPushEnv(obstacle=obstacle, **settings)
