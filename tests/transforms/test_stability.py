from __future__ import annotations

import re
import warnings

import pytest
import torch
from torchrl.envs import Compose, TransformedEnv

from ppt_rl.arms import PANDA, UR5E
from ppt_rl.envs import PushEnv
from ppt_rl.modules import CartesianImpedanceController, Kinematics
from ppt_rl.transforms import ImpedanceTransform, JointTorqueTransform
from ppt_rl.transforms.stability import _radius, _warn
from tests.engines import ONE_THREAD
from tests.transforms.mocks import MockArmEnv

STIFF = (400.0,) * 6
UNSTABLE = "unstable at this rate"


def controlled(controller: CartesianImpedanceController, *, control_dt: float = 0.01, **kwargs) -> TransformedEnv:
    base = PushEnv(2, control_dt=control_dt, engine=ONE_THREAD, seed=0, **kwargs)
    torque = JointTorqueTransform(Kinematics(base.arm, base.tool_length))
    return TransformedEnv(base, Compose(torque, ImpedanceTransform(controller)))


def chatter(env: TransformedEnv) -> float:
    """Mean joint speed while the arm is told to stand still, over the second half of a second [rad/s]."""
    td, speeds = env.reset(), []
    reference = torch.cat([td["pose"], torch.zeros_like(td["twist"])], -1)
    for _ in range(round(1.0 / env.base_env.control_dt)):
        td = env.step(td.set("action", reference))
        speeds.append(td["next", "joint_velocity"].norm(dim=-1).mean())
        td = env._step_mdp(td)
    return float(torch.stack(speeds[len(speeds) // 2 :]).mean())


def warned(call) -> list[str]:
    """What a call warns of instability."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        call()
    return [str(warning.message) for warning in caught if UNSTABLE in str(warning.message)]


@pytest.fixture(autouse=True)
def fresh_warnings():
    _warn.cache_clear()


@pytest.mark.parametrize("kwargs", [{}, {"arm": UR5E}], ids=["panda", "ur5e"])
@pytest.mark.parametrize(
    ("gains", "control_dt", "unstable"),
    [
        ({"stiffness": 400.0}, 0.01, False),
        ({"stiffness": 250.0}, 0.01, False),
        ({"stiffness": STIFF}, 0.01, True),
        ({"damping_ratio": 1.0}, 0.02, True),
        ({"damping_ratio": 0.5}, 0.02, False),
    ],
)
def test_the_controller_warns_exactly_where_the_simulated_arm_chatters(gains, control_dt, unstable, kwargs):
    arm = kwargs.get("arm", PANDA)
    env = controlled(
        CartesianImpedanceController(**gains, inertia=arm.apparent_inertia), control_dt=control_dt, **kwargs
    )
    moving = []
    assert bool(warned(lambda: moving.append(chatter(env)))) == unstable
    assert moving[0] > 0.05 if unstable else moving[0] < 0.02


def test_the_warning_comes_once_for_the_same_gains_and_has_the_figures():
    (message,) = warned(lambda: [controlled(CartesianImpedanceController(STIFF)).reset() for _ in range(2)])
    assert re.search(
        r"in each control step of 0\.01 s, small motions of panda at its home posture grow by a factor of [2-3]\.\d+; "
        r"expected at most 1\..* Lower the stiffness \(400, 400, 400, 400, 400, 400\) or the damping",
        message,
    )


def test_a_chain_without_an_arm_is_not_judged():
    env = TransformedEnv(MockArmEnv((2,), action_shape=(6,)), ImpedanceTransform(CartesianImpedanceController(STIFF)))
    assert warned(env.reset) == []


def test_the_damping_of_the_posture_is_part_of_the_judgement():
    controller = CartesianImpedanceController()
    gains = tuple(controller.stiffness.tolist()), tuple(controller.damping.tolist())
    assert _radius(PANDA, 0.15, *gains, 10.0, 2.0, 0.01) < 1 < _radius(PANDA, 0.15, *gains, 10.0, 600.0, 0.01)
