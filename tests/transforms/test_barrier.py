from __future__ import annotations

import pytest
import torch
from torchrl.envs import Compose, TransformedEnv

from ppt_rl.arms import PANDA
from ppt_rl.envs import PandaPushEnv
from ppt_rl.functional import PlaneBarrier, SpeedBarrier
from ppt_rl.modules import CartesianImpedanceController, Kinematics
from ppt_rl.transforms import BarrierTransform, ImpedanceTransform, JointTorqueTransform, MacroStepTransform
from tests.engines import COARSE
from tests.sampling import normal
from tests.transforms.cases import push_env
from tests.transforms.mocks import MockArmEnv, ScriptedEnv, actions_for, play


def test_a_wrench_within_the_limits_passes_bit_by_bit_and_so_does_every_torque():
    env = TransformedEnv(MockArmEnv((2,), action_shape=(6,)), BarrierTransform([SpeedBarrier(1e3, 1.0)]))
    steps = play(env, actions_for(env, 5))
    assert torch.equal(steps["next", "executed"], steps["action"])
    assert not steps["next", "barrier_change"].any()
    tight = TransformedEnv(MockArmEnv((2,), action_shape=(6,)), BarrierTransform([SpeedBarrier(1e-3)]))
    steps = play(tight, actions_for(tight, 5))
    assert torch.equal(steps["next", "executed"][..., 3:], steps["action"][..., 3:])
    change = (steps["next", "executed"] - steps["action"]).norm(dim=-1, keepdim=True)
    torch.testing.assert_close(steps["next", "barrier_change"], change)
    assert change.gt(0).any()


def test_the_force_changes_by_no_more_than_its_rate_from_zero_at_the_start_of_every_episode():
    still = torch.zeros(1, 21, 7), torch.zeros(1, 21, 6)
    env = TransformedEnv(
        ScriptedEnv(6, pose=still[0], twist=still[1]), BarrierTransform([SpeedBarrier(1.0)], force_rate=300.0, dt=0.01)
    )
    steps = play(env, 20 * normal(20, 1, 6).float())[0]
    force = torch.cat([torch.zeros(1, 3), steps["next", "executed"][:, :3]])
    change = force.diff(dim=0).norm(dim=-1)
    assert (change <= 3.0 * (1 + 1e-4)).all()
    assert change.max() > 2.99
    torch.testing.assert_close(steps["next", "barrier_force"], force[1:])


def test_a_rate_above_that_of_the_control_is_refused():
    with pytest.raises(ValueError, match=r"SpeedBarrier.* has a rate above 1 / dt, which is 100 1/s"):
        TransformedEnv(MockArmEnv((2,), action_shape=(6,)), BarrierTransform([SpeedBarrier(1.0, 101.0)])).reset()
    with pytest.raises(ValueError, match="has a rate above 1 / dt"):
        BarrierTransform([PlaneBarrier(rate=11.0)], dt=0.1)


def test_a_place_after_a_macro_step_is_refused():
    chain = Compose(MacroStepTransform(5), BarrierTransform([SpeedBarrier(1.0)]))
    with pytest.raises(ValueError, match="stands after a MacroStepTransform"):
        TransformedEnv(MockArmEnv((2,), action_shape=(6,)), chain).reset()


def test_on_the_arm_speed_and_height_keep_to_their_limits_within_a_stated_tolerance():
    """The inertia of the arm is not the one given, so the limits hold up to a third of the speed and to 3 mm."""

    def run(*barriers):
        env = push_env(
            2, JointTorqueTransform(Kinematics(PANDA, PandaPushEnv.tool.length)), *barriers,
            ImpedanceTransform(CartesianImpedanceController()), duration=1.2, engine=COARSE,
        )  # fmt: skip
        td = env.reset()
        reference = torch.cat([td["pose"], torch.zeros(2, 6)], -1)
        start, speeds, heights = td["pose"][0, 2].item(), [], []
        for number in range(110):
            rising = number < 50
            reference[:, 2] += 0.004 * rising
            reference[:, 9] = 0.4 * rising
            td = env.step(td.set("action", reference.clone()))["next"]
            speeds.append(td["twist"][:, :3].norm(dim=-1).max())
            heights.append(td["pose"][:, 2].max() - start)
        return max(speeds).item(), max(heights).item(), start

    fast, high, start = run()
    assert fast > 0.3
    assert high > 0.15
    ceiling = PlaneBarrier((0.0, 0.0, -1.0), -(start + 0.1))
    slow, low, _ = run(BarrierTransform([SpeedBarrier(0.2), ceiling]))
    assert slow < 0.2 * 4 / 3
    assert 0.08 < low < 0.103
