"""One case for each transform of the library, and the whole chain on the simulated arm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import torch
from tensordict import TensorDict
from tensordict.utils import NestedKey
from torchrl.envs import Compose, EnvBase, Transform, TransformedEnv

from ppt_rl.arms import PANDA
from ppt_rl.envs import PandaMazeEnv, PandaPushEnv
from ppt_rl.functional import MetricsConfig, PlaneBarrier, SpeedBarrier, ViaPointConfig
from ppt_rl.modules import CartesianImpedanceController, Kinematics, ProMP, TaskSpace
from ppt_rl.transforms import (
    ActionMapTransform,
    BarrierTransform,
    CartesianVelocityTransform,
    ContactViaPointTransform,
    EnergyAwareImpedanceTransform,
    EnergyBudgetTransform,
    EnergyPenaltyTransform,
    EnergyTankTransform,
    EpisodeMetricsTransform,
    HeadingFrameTransform,
    HoldActionTransform,
    ImpedanceTransform,
    JointTorqueTransform,
    MacroStepTransform,
    MotionMemoryTransform,
    PDTrackingTransform,
    PowerLimitTransform,
    ProMPTransform,
    RecedingKeys,
    RecedingProMPTransform,
    ReferenceGovernorTransform,
    ReferenceVelocityTransform,
    ViaPointTransform,
)
from tests.engines import ONE_THREAD
from tests.transforms.mocks import MockArmEnv

AXES = ("x", "y", "yaw")
ORIGIN = (0.36, 0.0, 0.02, 0.0, 1.0, 0.0, 0.0)


def make_promp(duration: float = 0.1, num_basis: int = 4) -> ProMP:
    """A primitive over x, y and yaw with a prior that is neither zero nor diagonal."""
    promp = ProMP(num_basis, 3, duration)
    generator = torch.Generator().manual_seed(11)
    size = num_basis * 3
    factor = 0.1 * torch.randn(size, size, generator=generator)
    promp.weights_mean.copy_(0.2 * torch.randn(num_basis, 3, generator=generator))
    promp.weights_cov.copy_(factor @ factor.mT + 0.01 * torch.eye(size))
    return promp


def make_promp_transform(**kwargs: Any) -> ProMPTransform:
    """Chunks of five references."""
    return ProMPTransform(make_promp(), TaskSpace(AXES, ORIGIN), **{"replan_steps": 5, **kwargs})


@dataclass(frozen=True)
class Case:
    """How one transform is tested.

    Attributes:
        make: the transform, with further arguments for it.
        inner: shape of the action towards the environment.
        outer: shape of the action from outside.
        state: keys of its state.
        written: keys that it adds to the observations, beyond its state.
        forward: keys that it adds to stored data.
        timed: whether it needs the control step.
        nested: arguments for a nested action, and for nested observations where the transform takes their keys.
        prefix: nest of the observations in the nested case.
        base: arguments for the mock environment.
    """

    make: Callable[..., Transform]
    inner: tuple[int, ...] = (7,)
    outer: tuple[int, ...] = (7,)
    state: tuple[str, ...] = ()
    written: tuple[NestedKey, ...] = ()
    forward: tuple[NestedKey, ...] = ()
    timed: bool = False
    nested: dict[str, Any] = field(default_factory=dict)
    prefix: tuple[str, ...] = ("agent",)
    base: dict[str, Any] = field(default_factory=dict)


_ACTION = {"action_key": ("agent", "action")}

CASES: dict[str, Case] = {
    "ActionMapTransform": Case(
        lambda **kwargs: ActionMapTransform(torch.arange(21.0).reshape(7, 3) / 10 - 1, **kwargs),
        outer=(3,),
        nested=_ACTION,
    ),
    "BarrierTransform": Case(
        lambda **kwargs: BarrierTransform(
            **{"barriers": [SpeedBarrier(0.1), PlaneBarrier(offset=0.1)], "force_rate": 50.0, **kwargs}
        ),
        inner=(6,),
        outer=(6,),
        state=("barrier_change", "barrier_force"),
        timed=True,
        nested={**_ACTION, "reading_keys": (("agent", "pose"), ("agent", "twist"))},
    ),
    "CartesianVelocityTransform": Case(
        lambda **kwargs: CartesianVelocityTransform(TaskSpace(AXES, ORIGIN), max_lead=(0.05, 0.05, 0.2), **kwargs),
        inner=(13,),
        outer=(3,),
        state=("reference_position",),
        timed=True,
        nested={**_ACTION, "pose_key": ("agent", "pose")},
    ),
    "ContactViaPointTransform": Case(
        lambda **kwargs: ContactViaPointTransform(
            0.1,
            ViaPointConfig(capacity=3, lookahead=0.05, spacing=0.02),
            **{"wrench_key": "wrench", "heading_key": "start_heading", **kwargs},
        ),
        state=(
            "contact",
            "new_wall",
            "via_mask",
            "via_wait",
            "via_pause",
            "via_phase",
            "via_tangent",
            "via_position",
            "via_cov",
        ),
        timed=True,
        nested={f"{key}_key": ("agent", key) for key in ("pose", "twist", "wrench")}
        | {"heading_key": ("agent", "start_heading")},
        base={"via_points": False},
    ),
    "EnergyBudgetTransform": Case(
        lambda **kwargs: EnergyBudgetTransform(1.3, **{"limit_key": "start_heading", **kwargs}),
        outer=(8,),
        state=("energy_budget",),
        nested={**_ACTION, "limit_key": ("agent", "start_heading")},
    ),
    "EnergyPenaltyTransform": Case(
        lambda **kwargs: EnergyPenaltyTransform(0.5, **{"energy_key": "start_heading", **kwargs}),
        nested={"energy_key": ("agent", "start_heading")},
    ),
    "EnergyAwareImpedanceTransform": Case(
        lambda **kwargs: EnergyAwareImpedanceTransform(CartesianImpedanceController(), 0.5, 1.0, **kwargs),
        inner=(6,),
        outer=(13,),
        state=("stiffness_factor", "damping_factor"),
        timed=True,
        nested={**_ACTION, "pose_key": ("agent", "pose"), "twist_key": ("agent", "twist")},
    ),
    "EnergyTankTransform": Case(
        lambda **kwargs: EnergyTankTransform(
            p_max=1.0, e_max=0.02, position_key="joint_position", **{"flow_key": "joint_velocity", **kwargs}
        ),
        state=("tank_energy", "valve", "tank_energy_debt"),
        timed=True,
        nested={"effort_key": ("agent", "action")},
    ),
    "EpisodeMetricsTransform": Case(
        EpisodeMetricsTransform,
        state=("metrics_memory",),
        written=tuple(
            ("metrics", name)
            for name in (
                "max_power",
                "max_power_measured",
                "work",
                "jerk_rms",
                "wrench_p95",
                "overload_ratio",
                "contact_continuity",
            )
        ),
        timed=True,
        nested={"twist_key": ("agent", "twist"), "wrench_key": ("agent", "wrench")},
    ),
    "HeadingFrameTransform": Case(
        HeadingFrameTransform,
        state=("heading", "smooth_wrench"),
        written=("heading_twist", "heading_wrench"),
        timed=True,
        nested={
            "twist_key": ("agent", "twist"),
            "wrench_key": ("agent", "wrench"),
            "start_key": ("agent", "start_heading"),
        },
    ),
    "HoldActionTransform": Case(
        lambda **kwargs: HoldActionTransform(3, smoothing=0.5, **kwargs),
        inner=(3, 7),
        outer=(7,),
        state=("last_action",),
        nested=_ACTION,
    ),
    "ImpedanceTransform": Case(
        lambda **kwargs: ImpedanceTransform(CartesianImpedanceController(), **kwargs),
        inner=(6,),
        outer=(13,),
        nested={**_ACTION, "pose_key": ("agent", "pose"), "twist_key": ("agent", "twist")},
    ),
    "JointTorqueTransform": Case(
        lambda **kwargs: JointTorqueTransform(Kinematics(PANDA, 0.1), max_torque_rate=1000.0, **kwargs),
        outer=(6,),
        state=("power", "torque"),
        timed=True,
        nested=_ACTION,
    ),
    "MacroStepTransform": Case(
        lambda **kwargs: MacroStepTransform(3, **{"discount": 0.9, "trace_keys": ["joint_velocity"], **kwargs}),
        outer=(3, 7),
        written=("control_steps", ("trace", "joint_velocity")),
        nested=_ACTION,
    ),
    "MotionMemoryTransform": Case(
        lambda **kwargs: MotionMemoryTransform(**{"heading_key": "start_heading", **kwargs}),
        state=("creep", "course"),
        written=("heading_creep", "heading_course"),
        timed=True,
        nested={"twist_key": ("agent", "twist"), "heading_key": ("agent", "start_heading")},
    ),
    "PDTrackingTransform": Case(
        lambda **kwargs: PDTrackingTransform(20.0, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0], continuous=(6,), **kwargs),
        outer=(14,),
        nested=_ACTION,
    ),
    "PowerLimitTransform": Case(
        lambda **kwargs: PowerLimitTransform(16.0, penalty=10.0, terminate=True, **kwargs),
        written=("cost",),
        forward=("cost",),
        timed=True,
        nested={"twist_key": ("agent", "twist"), "wrench_key": ("agent", "wrench")},
    ),
    "ProMPTransform": Case(
        make_promp_transform,
        inner=(5, 13),
        outer=(12,),
        state=("phase", "reference_position", "reference_velocity", "weights"),
        timed=True,
        nested={**_ACTION, "pose_key": ("agent", "pose")},
    ),
    "RecedingProMPTransform": Case(
        lambda **kwargs: RecedingProMPTransform(
            make_promp(),
            TaskSpace(("x", "y", "z"), ORIGIN),
            **{"replan_steps": 5, "keys": RecedingKeys(heading="start_heading"), **kwargs},
        ),
        inner=(5, 13),
        outer=(12,),
        state=("phase", "reference_position", "reference_velocity", "weights"),
        timed=True,
        nested={
            "keys": RecedingKeys(action=("agent", "action"), pose=("agent", "pose"), heading=("agent", "start_heading"))
        },
    ),
    "ReferenceGovernorTransform": Case(
        lambda **kwargs: ReferenceGovernorTransform(
            **{"with_motion": True, "controller": CartesianImpedanceController(), **kwargs}
        ),
        inner=(13,),
        outer=(13,),
        state=("governed_pose", "governor_lag"),
        timed=True,
        nested={**_ACTION, "reading_keys": (("agent", "pose"), ("agent", "twist"))},
    ),
    "ReferenceVelocityTransform": Case(
        lambda **kwargs: ReferenceVelocityTransform(make_promp(), max_velocity=5.0, **kwargs),
        inner=(3, 3),
        outer=(3, 3),
        state=("phase",),
        timed=True,
        nested=_ACTION,
    ),
    "ViaPointTransform": Case(
        lambda **kwargs: ViaPointTransform(make_promp(), write_cov=True, **kwargs),
        written=("weights_mean", "weights_cov"),
        forward=("weights_mean", "weights_cov"),
        nested={"prefix": ("agent",)},
    ),
}


def standalone(name: str) -> Transform:
    """A case's transform for use without an environment of its own: it is told the control step."""
    case = CASES[name]
    return case.make(dt=0.01) if case.timed else case.make()


def make_base(name: str, batch: tuple[int, ...] = (), **kwargs: Any) -> MockArmEnv:
    """The mock environment that a case's transform goes on."""
    case = CASES[name]
    return MockArmEnv(batch, action_shape=case.inner, **{"horizons": (6, 4), **case.base, **kwargs})


def make_env(name: str, batch: tuple[int, ...] = (), **kwargs: Any) -> TransformedEnv:
    """A case's transform on its mock environment."""
    return TransformedEnv(make_base(name, batch, **kwargs), CASES[name].make())


def make_nested(name: str, batch: tuple[int, ...] = ()) -> TransformedEnv:
    """A case's transform with nested keys."""
    case = CASES[name]
    key = case.nested.get("action_key", case.nested.get("effort_key", "action"))
    key = case.nested["keys"].action if "keys" in case.nested else key
    base = make_base(name, batch, action_key=key, prefix=case.prefix)
    return TransformedEnv(base, case.make(**case.nested))


def stored(name: str, batch: tuple[int, ...] = (4,), seed: int = 3) -> TensorDict:
    """Stored data with the action as it comes from outside."""
    base = make_base(name, batch)
    generator = torch.Generator().manual_seed(seed)
    td = base.reset()
    td["action"] = 0.5 * torch.randn(*batch, *CASES[name].outer, generator=generator)
    return td


def push_env(num_envs: int = 2, *transforms: Transform, duration: float = 0.1, seed: int = 0, **kwargs: Any) -> EnvBase:
    """The pushing task on one thread, with transforms."""
    base = PandaPushEnv(num_envs, duration=duration, seed=seed, **{"engine": ONE_THREAD, **kwargs})
    return TransformedEnv(base, Compose(*transforms)) if transforms else base


def sliding_env(base: PandaMazeEnv) -> TransformedEnv:
    """A maze in which references drive the tool and its heading is kept."""
    kinematics, controller = Kinematics(base.arm, base.tool_length), CartesianImpedanceController(stiffness=250.0)
    return TransformedEnv(
        base,
        Compose(
            JointTorqueTransform(kinematics, posture_stiffness=2.0),
            ImpedanceTransform(controller),
            HeadingFrameTransform(),
        ),
    )


def control_chain() -> list[Transform]:
    """What runs at control rate."""
    return [
        JointTorqueTransform(Kinematics(PANDA, PandaPushEnv.tool.length), max_torque_rate=1000.0),
        EnergyTankTransform(),
        ImpedanceTransform(CartesianImpedanceController()),
        EpisodeMetricsTransform(MetricsConfig()),
    ]


def make_chain_env(num_envs: int = 2, replan_steps: int = 5, duration: float = 0.1, **kwargs: Any) -> TransformedEnv:
    """The whole chain of the method on the pushing task."""
    promp = make_promp(duration)
    return push_env(
        num_envs,
        *control_chain(),
        MacroStepTransform(replan_steps, trace_keys=["power"]),
        ProMPTransform(promp, TaskSpace(AXES, ORIGIN), replan_steps=replan_steps),
        ViaPointTransform(promp),
        duration=duration,
        **kwargs,
    )
