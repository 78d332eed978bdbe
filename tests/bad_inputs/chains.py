"""Bad chains and bad tensordicts: wrong order, missing entries, wrong shapes and types, actions that are not finite."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs import Compose, EnvBase, Transform, TransformedEnv
from torchrl.envs.custom import PendulumEnv

from ppt_rl.arms import PANDA
from ppt_rl.evaluation import record_episodes, run_episodes
from ppt_rl.functional import MetricsConfig
from ppt_rl.modules import CartesianImpedanceController, Kinematics, ProMP, TaskSpace
from ppt_rl.training import make_actor_critic
from ppt_rl.transforms import (
    CartesianVelocityTransform,
    ContactViaPointTransform,
    EnergyBudgetTransform,
    EnergyTankTransform,
    EpisodeMetricsTransform,
    HeadingFrameTransform,
    ImpedanceTransform,
    JointTorqueTransform,
    MacroStepTransform,
    MotionMemoryTransform,
    PowerLimitTransform,
    ProMPTransform,
    RecedingProMPTransform,
    ViaPointTransform,
)
from tests.bad_inputs.entry import BadInput
from tests.bad_inputs.shared import push_env
from tests.transforms.mocks import MockArmEnv

__all__ = ["ENTRIES"]

_PLANE = TaskSpace(("x", "y", "yaw"), (0.36, 0.0, 0.02, 0.0, 1.0, 0.0, 0.0))
_WORLD = TaskSpace(("x", "y", "z"), (0.36, 0.0, 0.02, 0.0, 1.0, 0.0, 0.0))


def _torque(**kwargs: Any) -> JointTorqueTransform:
    return JointTorqueTransform(Kinematics(PANDA, 0.1), **kwargs)


def _spring() -> ImpedanceTransform:
    return ImpedanceTransform(CartesianImpedanceController())


def _primitive(dof: int = 3) -> ProMP:
    return ProMP(4, dof, 0.1)


def _decoder(**kwargs: Any) -> ProMPTransform:
    return ProMPTransform(_primitive(), _PLANE, **{"replan_steps": 5, **kwargs})


def _mock(*transforms: Transform, **kwargs: Any) -> EnvBase:
    base = MockArmEnv((2,), **kwargs)
    return TransformedEnv(base, Compose(*transforms)) if transforms else base


def _step(env: EnvBase, action: Tensor | None = None, **entries: Any) -> None:
    """One step of an environment with entries of the tensordict replaced, or removed where they are None."""
    tensordict = env.reset()
    tensordict = env.rand_action(tensordict) if action is None else tensordict.set("action", action)
    for key, value in entries.items():
        tensordict = tensordict.exclude(key) if value is None else tensordict.set(key, value)
    env.step(tensordict)


def _chain(name: str, match: str, make: Callable[[], EnvBase], action: Any = None, **kwargs: Any) -> BadInput:
    pending = kwargs.pop("pending", False)
    return BadInput(name, lambda: _step(make(), action() if callable(action) else action, **kwargs), match, pending)


def _without(*names: str, **kwargs: Any) -> EnvBase:
    """A mock environment that observes less."""
    base = MockArmEnv((2,), **kwargs)
    base.observation_spec = base.observation_spec.clone()
    for name in names:
        del base.observation_spec[name]
    observe = base._observe
    base._observe = lambda *args: observe(*args).exclude(*names)
    return base


def _clocked(dt: Any) -> EnvBase:
    base = MockArmEnv((2,))
    base.control_dt = dt
    return base


_ORDER = [
    _chain("a tank after the macro step", r"EnergyTankTransform stands after a MacroStepTransform.*append it before",
           lambda: _mock(MacroStepTransform(3), EnergyTankTransform())),
    _chain("a primitive without a macro step", r"reference_pose \(2, 5, 7\)",
           lambda: _mock(_torque(), _spring(), _decoder())),
    _chain("a primitive straight on joint torques", r"action has shape \(2, 5, 13\); expected \(2, 7\)",
           lambda: TransformedEnv(push_env(), _decoder())),
    _chain("impedance below joint torque", r"wrench has shape \(2, 13\)|reference.*\(2, 7\); expected|13",
           lambda: _mock(_spring(), _torque(), action_shape=(6,)), lambda: torch.zeros(2, 6)),
    _chain("a chunk of weights where a wrench is expected", r"wrench has shape \(2, 12\); expected \(\*batch, 6\)",
           lambda: _mock(_torque()), lambda: torch.zeros(2, 12)),
    _chain("weights where a chunk is expected", r"action has shape \(2, 12\); expected a chunk \(2, 5, A\)",
           lambda: _mock(MacroStepTransform(5)), lambda: torch.zeros(2, 12)),
    _chain("a wrench where a reference is expected", r"reference \(pose and twist\) has shape \(2, 6\); .*13",
           lambda: _mock(_spring(), action_shape=(6,)), lambda: torch.zeros(2, 6)),
    _chain("a torque where a wrench is expected", r"wrench has shape \(2, 7\); expected \(\*batch, 6\)",
           lambda: _mock(_torque()), lambda: torch.zeros(2, 7)),
    _chain("two tanks with the same keys", "tank_energy.*(expected|Pass|Give)",
           lambda: _mock(EnergyTankTransform(), EnergyTankTransform())),
    _chain("two macro steps", r"action has shape|MacroStepTransform.*(expected|Leave)",
           lambda: _mock(MacroStepTransform(3), MacroStepTransform(2))),
    _chain("two transforms of metrics", "metrics.*(expected|Leave|Remove)",
           lambda: _mock(EpisodeMetricsTransform(), EpisodeMetricsTransform())),
    _chain("a macro step with another length than the primitive's chunk", r"action has shape \(2, 5, 13\); .*4",
           lambda: _mock(_torque(), _spring(), MacroStepTransform(4), _decoder())),
    _chain("via-points of another dimension than the primitive", r"via_position \(2, 2, 3\).*expected",
           lambda: _mock(ViaPointTransform(_primitive(2)))),
    BadInput("a macro step without an environment", lambda: MacroStepTransform(3).inv(
        TensorDict({"action": torch.zeros(2, 3, 7)}, 2)), "MacroStepTransform .*; append it to a TransformedEnv"),
]  # fmt: skip
_MISSING = [
    _chain("a budget that no tank reads", r"EnergyBudgetTransform needs 'e_max'.*EnergyTankTransform\(e_max_key=",
           lambda: _mock(EnergyTankTransform(), EnergyBudgetTransform(1.0))),
    _chain("a tank where no velocity has the action's size", "found no velocity for the effort 'action' of size 3",
           lambda: _mock(EnergyTankTransform(), action_shape=(3,))),
    _chain("a tank on a pendulum without flow_key", "no velocity for the effort 'action' of size 1.*Pass flow_key",
           lambda: TransformedEnv(PendulumEnv(), EnergyTankTransform(dt=0.05))),
    _chain("a position of another size", r"the position 'pose' has shape \(2, 7\).*\(2, 6\).*Leave position_key out",
           lambda: _mock(EnergyTankTransform(flow_key="twist", position_key="pose"), action_shape=(6,))),
    _chain("a position that is not observed", r"EnergyTankTransform needs \['angle'\]; the tensordict holds",
           lambda: _mock(EnergyTankTransform(flow_key="joint_velocity", position_key="angle"))),
    _chain("a flow_key that is not observed",
           r"EnergyTankTransform needs \['speed'\]; the tensordict holds.*Pass flow_key= where it has another name",
           lambda: _mock(EnergyTankTransform(flow_key="speed"))),
    _chain("a tensordict without the tank's level", "tank_energy.*(expected|Pass|Keep|Take)",
           lambda: _mock(EnergyTankTransform()), tank_energy=None),
    _chain("impedance without a pose", r"ImpedanceTransform needs \['pose'\]",
           lambda: TransformedEnv(_without("pose", action_shape=(6,)), _spring())),
    _chain("joint torque without joint positions", r"JointTorqueTransform needs \['joint_position'\]",
           lambda: TransformedEnv(_without("joint_position"), _torque())),
    _chain("metrics without a wrench", r"EpisodeMetricsTransform needs \['wrench'\]",
           lambda: TransformedEnv(_without("wrench"), EpisodeMetricsTransform())),
    _chain("a power limit without a twist", r"PowerLimitTransform needs \['twist'\]",
           lambda: TransformedEnv(_without("twist"), PowerLimitTransform())),
    _chain("a heading without a start", r"HeadingFrameTransform needs \['start_heading'\]",
           lambda: TransformedEnv(_without("start_heading"), HeadingFrameTransform())),
    _chain("a memory of motion without a heading",
           r"MotionMemoryTransform needs \['heading'\].*HeadingFrameTransform writes heading",
           lambda: _mock(MotionMemoryTransform())),
    _chain("touch without a heading", r"needs \['smooth_wrench', 'heading'\].*HeadingFrameTransform writes",
           lambda: TransformedEnv(MockArmEnv((2,), via_points=False), ContactViaPointTransform(0.6))),
    _chain("via-points without covariances", r"ViaPointTransform needs \['via_cov'\]",
           lambda: TransformedEnv(_without("via_cov"), ViaPointTransform(_primitive()))),
    _chain("a receding primitive without a heading", r"RecedingProMPTransform needs \['heading'\]",
           lambda: _mock(MacroStepTransform(5), RecedingProMPTransform(
               _primitive(), _WORLD, replan_steps=5), action_shape=(13,))),
    _chain("an action key that is not there", r"'force'; expected one of .*'action'",
           lambda: _mock(_torque(action_key="force"))),
    _chain("a tank with an effort key that is not there", r"'force'.*(expected|Pass|needs)",
           lambda: _mock(EnergyTankTransform(effort_key="force"))),
    _chain("a trace of what is not observed", "trace key or interrupt_key .*'speed'.* is no observation of a",
           lambda: _mock(MacroStepTransform(3, trace_keys=["speed"]))),
    _chain("a trace without num_steps", "trace_keys need num_steps, .*; pass num_steps=N",
           lambda: _mock(MacroStepTransform(trace_keys=["pose"])), lambda: torch.zeros(2, 3, 7)),
    _chain("an interrupt that is not observed", "(interrupt_key|new_wall).*(expected|there are)",
           lambda: _mock(MacroStepTransform(3, interrupt_key="new_wall"))),
]  # fmt: skip
_TIME = [
    *(
        _chain(f"{type(make()).__name__} where no control step is known",
               rf"{type(make()).__name__} needs the control step, but MockArmEnv has no attribute .*Pass dt=",
               lambda make=make: TransformedEnv(_clocked(None), make()))
        for make in (EnergyTankTransform, EpisodeMetricsTransform, PowerLimitTransform, HeadingFrameTransform)
    ),
    _chain("another dt than the environment's", "has dt=0.02 s, but its environment has control_dt=0.01 s; expected",
           lambda: _mock(EnergyTankTransform(dt=0.02))),
    *(
        _chain(f"control_dt is {dt!r}", f"control_dt of MockArmEnv is {dt!r}; expected a finite number above 0 s",
               lambda dt=dt: TransformedEnv(_clocked(dt), EnergyTankTransform()))
        for dt in (0.0, -0.01, math.nan, "fast")
    ),
    _chain("a control step that does not divide the primitive", "duration is 0.1 s; expected a multiple .*dt=0.03",
           lambda: TransformedEnv(_clocked(0.03), _decoder())),
    _chain("a filter faster than the control rate", "cutoff is 80.0 Hz; expected a frequency below",
           lambda: _mock(EpisodeMetricsTransform(MetricsConfig(cutoff=80.0)))),
]  # fmt: skip
_VALUES = [
    _chain("a tank with a torque that is no number", r"effort holds 14 NaN or infinite",
           lambda: _mock(EnergyTankTransform()), lambda: torch.full((2, 7), math.nan)),
    _chain("a tank with an infinite torque", r"effort holds 14 NaN or infinite", lambda: _mock(EnergyTankTransform()),
           lambda: torch.full((2, 7), math.inf)),
    _chain("a level that is not a number", "tank_energy holds 2 NaN", lambda: _mock(EnergyTankTransform()),
           tank_energy=torch.full((2, 1), math.nan)),
    _chain("a negative level", "level 'tank_energy' is negative; expected 0 to 3.0 J",
           lambda: _mock(EnergyTankTransform()), tank_energy=torch.full((2, 1), -1.0)),
    _chain("a level of another shape", r"tank_energy.*\(2, 2\)", lambda: _mock(EnergyTankTransform()),
           tank_energy=torch.ones(2, 2)),
    _chain("a torque of whole numbers", "action.*torch.int64.*expected", lambda: _mock(EnergyTankTransform()),
           lambda: torch.ones(2, 7, dtype=torch.int64)),
    _chain("a residual that is not a number", r"action \(ProMP residual\) holds 24 NaN",
           lambda: _mock(_torque(), _spring(), MacroStepTransform(5), _decoder()),
           lambda: torch.full((2, 12), math.nan)),
    _chain("a residual of another size", r"action \(ProMP residual\) has shape \(2, 9\); expected \(\*batch, 12\)",
           lambda: _mock(_torque(), _spring(), MacroStepTransform(5), _decoder()), lambda: torch.zeros(2, 9)),
    _chain("reference weights of another size", r"weights_mean.*\(2, 5, 3\).*expected",
           lambda: _mock(_torque(), _spring(), MacroStepTransform(5), _decoder()), lambda: torch.zeros(2, 12),
           weights_mean=torch.zeros(2, 5, 3)),
    _chain("a chunk that is not a number", r"action \(chunk\) holds 42 NaN", lambda: _mock(MacroStepTransform(3)),
           lambda: torch.full((2, 3, 7), math.nan)),
    _chain("an empty chunk", r"action has shape \(2, 0, 7\); expected a chunk", lambda: _mock(MacroStepTransform()),
           lambda: torch.zeros(2, 0, 7)),
    _chain("a velocity that is not a number", "action.* holds .* NaN",
           lambda: _mock(_torque(), _spring(), CartesianVelocityTransform(_PLANE)),
           lambda: torch.full((2, 3), math.nan)),
    _chain("a velocity of another size", r"action.*\(2, 4\); expected \(\*batch, 3\)",
           lambda: _mock(_torque(), _spring(), CartesianVelocityTransform(_PLANE)), lambda: torch.zeros(2, 4)),
    _chain("a wrench that is not a number", "effort holds 12 NaN",
           lambda: _mock(EnergyTankTransform(flow_key="twist"), action_shape=(6,)),
           lambda: torch.full((2, 6), math.nan)),
    _chain("a torque of another size", r"action has shape \(2, 6\); expected \(2, 7\): the joint torques", push_env,
           lambda: torch.zeros(2, 6)),
    _chain("a torque that is not a number", r"action \(joint torque\) holds 14 NaN", push_env,
           lambda: torch.full((2, 7), math.nan)),
    _chain("a torque that is infinite", r"action \(joint torque\) holds 14 NaN or infinite", push_env,
           lambda: torch.full((2, 7), math.inf)),
]  # fmt: skip
_AGENTS = [
    BadInput("an actor that reads what is not observed",
             lambda: make_actor_critic(push_env(), ["map"], ["pose"], initial_scale=1.0),
             r"observations \['map'\] are unknown; (expected|the environment has)"),
    BadInput("an actor with a scale of zero",
             lambda: make_actor_critic(push_env(), ["pose"], ["pose"], initial_scale=0.0),
             "initial_scale is 0.0; expected"),
    BadInput("episodes without metrics", lambda: run_episodes(push_env(), lambda td: td, 1),
             "metrics.*EpisodeMetricsTransform"),
    BadInput("no episodes", lambda: run_episodes(push_env(), lambda td: td, 0), "episodes is 0; expected"),
    BadInput("half an episode", lambda: run_episodes(push_env(), lambda td: td, 0.5), "episodes is 0.5; expected"),
    BadInput("a record of what is not observed", lambda: record_episodes(
        TransformedEnv(push_env(), EpisodeMetricsTransform()), lambda td: td, ["map"]), r"keys.*\['map'\].*expected"),
]  # fmt: skip

ENTRIES = [*_ORDER, *_MISSING, *_TIME, *_VALUES, *_AGENTS]
