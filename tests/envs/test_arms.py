"""Every task with every arm."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close
from torchrl.envs import Compose, TransformedEnv
from torchrl.envs.utils import check_env_specs

from ppt_rl.arms import FR3, PANDA, UR5E, Arm, Limits, arm_names, find_arm
from ppt_rl.envs import (
    ArmEnv,
    EngineConfig,
    MazeEnv,
    MazeLayout,
    PandaEnv,
    PandaMazeEnv,
    PandaPushEnv,
    PushEnv,
    Straight,
)
from ppt_rl.modules import CartesianImpedanceController, Kinematics, ProMP, TaskSpace
from ppt_rl.tasks.push import PUSH_AXES, fit_push_prior
from ppt_rl.transforms import (
    EnergyTankTransform,
    EpisodeMetricsTransform,
    ImpedanceTransform,
    JointTorqueTransform,
    MacroStepTransform,
    ProMPTransform,
    ViaPointTransform,
)
from tests.engines import COARSE

ARMS = [find_arm(name) for name in arm_names()]
MAKES = [ArmEnv, PushEnv, MazeEnv.straight, MazeEnv.mazes]
every_arm = pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)


def chained(base: ArmEnv, **posture: float) -> TransformedEnv:
    """References as the action, behind a tank."""
    return TransformedEnv(
        base,
        Compose(
            JointTorqueTransform(Kinematics(base.arm, base.tool_length), **posture),
            EnergyTankTransform(flow_key="twist"),
            ImpedanceTransform(CartesianImpedanceController(inertia=base.arm.apparent_inertia)),
            EpisodeMetricsTransform(),
        ),
    )


@every_arm
@pytest.mark.parametrize("make", MAKES)
def test_every_task_keeps_its_contract_with_every_arm(make, arm):
    env = make(2, arm=arm, duration=0.05, seed=0, engine=COARSE)
    assert env.arm is arm
    assert env.action_spec.shape == (2, arm.num_joints)
    assert_close(env.action_spec.space.high, torch.tensor(arm.joints.torque_limits).expand(2, -1))
    check_env_specs(env)


@every_arm
@pytest.mark.parametrize("make", MAKES)
def test_the_tool_follows_a_reference_behind_the_tank_with_every_arm_in_every_task(make, arm):
    env = chained(make(2, arm=arm, duration=2.0, seed=0, engine=COARSE), posture_stiffness=2.0)
    observation = env.reset()
    start = observation["pose"]
    assert (start[:, 4] > 1 - 1e-6).all(), "the tool points down, and its quaternion has the sign of the start pose"
    goal = torch.cat([start, torch.zeros(2, 6)], -1)
    goal[:, 2] += 0.03
    for _ in range(120):
        observation = env.step_mdp(env.step(observation.set("action", goal)))
    assert_close(observation["pose"][:, :3], goal[:, :3], rtol=0, atol=2e-3)
    assert (observation["pose"][:, 4] > 1 - 1e-4).all()
    assert (observation["tank_energy"] < 3.0).all()
    assert not observation["diverged"].any()


@every_arm
def test_the_reference_alone_pushes_nine_of_ten_boxes(arm):
    promp = fit_push_prior(ProMP(8, 3, 3.0), num_demonstrations=128)
    base = PushEnv(64, arm=arm, seed=10_000, engine=EngineConfig(physics_dt=0.001))
    env = chained(base)
    env.append_transform(MacroStepTransform(base.horizon))
    env.append_transform(ProMPTransform(promp, TaskSpace(PUSH_AXES, base.start_pose)))
    env.append_transform(ViaPointTransform(promp))
    done = env.step(env.reset().set("action", env.action_spec.zero()))["next"]
    assert done["success"].float().mean() >= 0.9


def test_an_arm_of_ones_own_needs_no_file_of_the_library():
    home = (*UR5E.home[:-1], UR5E.home[-1] + 0.5)
    turned = replace(UR5E.chain, tool_turn=UR5E.chain.tool_turn + 0.5)
    env = PushEnv(2, arm=replace(UR5E, name="mine", chain=turned, home=home), seed=0, engine=COARSE)
    assert_close(env.reset()["pose"], PushEnv(2, arm=UR5E, seed=0, engine=COARSE).reset()["pose"], rtol=0, atol=1e-5)


# -- reach -------------------------------------------------------------------------------------------------------------


def with_reach(arm: Arm, low: float, high: float) -> Arm:
    return replace(arm, reach=Limits(low, high))


def test_mazes_lie_within_the_reach_of_the_arm():
    arm = with_reach(PANDA, 0.35, 0.66)
    for make in (MazeEnv.straight, MazeEnv.mazes):
        env = make(8, arm=arm, seed=0, engine=COARSE)
        env.reset()
        for corridor in env._episode.corridors:
            radius = torch.from_numpy(corridor.centre[:, :2]).norm(dim=-1)
            assert (radius >= 0.35).all()
            assert (radius <= 0.66).all()


def test_a_layout_out_of_the_arms_reach_is_refused_and_one_of_longer_reach_takes_it():
    layout = MazeLayout((Straight(0.15),), start=(0.74, 0.0))
    with pytest.raises(ValueError, match=r"the maze lies .* from the base; expected 0.3 to 0.7 m"):
        MazeEnv.of([layout], arm=UR5E)
    MazeEnv.of([layout], arm=with_reach(UR5E, 0.3, 0.78), engine=COARSE).reset()


# -- the Panda's names -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("make", "kind"), [(PandaEnv, ArmEnv), (PandaPushEnv, PushEnv), (PandaMazeEnv.mazes, MazeEnv)])
def test_the_pandas_environments_are_those_of_every_arm_with_the_panda(make, kind):
    env, same = make(2, seed=0, engine=COARSE), (MazeEnv.mazes if kind is MazeEnv else kind)(2, seed=0, engine=COARSE)
    assert isinstance(env, PandaEnv)
    assert isinstance(env, kind)
    assert env.arm == PANDA
    first, second = env.reset(), same.reset()
    assert all(torch.equal(first[key], second[key]) for key in first.keys(True, True))


@pytest.mark.parametrize("make", [PandaEnv, PandaPushEnv, PandaMazeEnv.straight])
def test_a_pandas_environment_refuses_another_arm(make):
    with pytest.raises(ValueError, match=r"arm is 'fr3', but Panda\w*Env is the Panda's.* Use ArmEnv, PushEnv or"):
        make(2, arm=FR3)
