from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.testing import assert_close
from torchrl.envs import Compose, TransformedEnv

from ppt_rl.arms import PANDA
from ppt_rl.envs import PandaPushEnv
from ppt_rl.modules import CartesianImpedanceController, Kinematics
from ppt_rl.transforms import (
    ImpedanceTransform,
    JointTorqueTransform,
    MacroStepTransform,
    ProMPTransform,
    ReferenceGovernorTransform,
)
from tests.engines import COARSE
from tests.sampling import normal
from tests.transforms.cases import make_promp_transform, push_env
from tests.transforms.mocks import MockArmEnv, ScriptedEnv, actions_for, play

LAWS = settings(max_examples=10, deadline=None, derandomize=True)
START = torch.tensor((0.4, -0.1, 0.2, 0.0, 1.0, 0.0, 0.0))


def scripted(tool, gains, **kwargs):
    """An arm whose tool follows a script ``(T + 1, 13)``, with impedance and governor; ``executed`` is the wrench."""
    base = ScriptedEnv(6, pose=tool[None, :, :7], twist=tool[None, :, 7:])
    governor = ReferenceGovernorTransform(**{"dt": 0.01, **kwargs})
    return TransformedEnv(base, Compose(ImpedanceTransform(gains), governor))


def steps(env, references):
    return play(env, references.unsqueeze(1))[0]


def references(seed, count=12, size=0.3):
    away = size * normal(count, 13, seed=seed).float()
    away[:, :7] += START
    away[:, 3:7] /= away[:, 3:7].norm(dim=-1, keepdim=True)
    return away


@LAWS
@given(seed=st.integers(0, 10**6), f_max=st.floats(1.0, 100.0), with_motion=st.booleans())
def test_the_wrench_on_a_tool_that_is_held_still_is_within_the_limits_at_every_step(seed, f_max, with_motion):
    controller = CartesianImpedanceController(400.0)
    tool = torch.cat([START, torch.zeros(6)]).expand(13, 13)
    wrench = steps(scripted(tool, controller, f_max=f_max, with_motion=with_motion), references(seed))[
        "next", "executed"
    ]
    assert (wrench[:, :3].norm(dim=-1) <= f_max * (1 + 1e-5) + 1e-3).all()
    assert (wrench[:, 3:].norm(dim=-1) <= 10.0 * (1 + 1e-4)).all()


@LAWS
@given(seed=st.integers(0, 10**6))
def test_far_from_the_limits_the_wrench_is_that_of_the_same_chain_without_a_governor(seed):
    controller = CartesianImpedanceController(400.0)
    tool = torch.cat([START + 0.01 * normal(13, 7, seed=seed).float(), normal(13, 6, seed=seed + 1).float()], -1)
    governed = steps(scripted(tool, controller, f_max=1e5, torque_max=1e5), references(seed))
    plain = TransformedEnv(
        ScriptedEnv(6, pose=tool[None, :, :7], twist=tool[None, :, 7:]), ImpedanceTransform(controller)
    )
    assert torch.equal(governed["next", "executed"], steps(plain, references(seed))["next", "executed"])
    assert not governed["next", "governor_lag"].any()


def test_after_blocking_the_governed_pose_catches_up_at_the_given_speed():
    tool = torch.cat([START, torch.zeros(6)]).repeat(41, 1)
    far = tool[0].clone()
    far[0] += 0.2
    env = scripted(tool, CartesianImpedanceController(400.0), f_max=20.0, catch_up_speed=0.3)
    lagging = torch.cat([far.expand(20, 13), tool[0].expand(20, 13)])  # far away, then back
    run = steps(env, lagging)
    assert_close(run["next", "governed_pose"][:20, 0] - START[0], torch.full((20,), 0.05), rtol=0, atol=1e-5)
    assert_close(run["next", "governor_lag"][:20, 0], torch.full((20,), 0.15), rtol=0, atol=1e-5)
    moved = run["next", "governed_pose"][19:, 0].diff()
    assert (moved.abs() <= 0.3 * 0.01 + 1e-6).all()
    assert_close(run["next", "governed_pose"][-1], START, rtol=0, atol=0)
    assert not run["next", "governor_lag"][-1].any()


def test_the_controller_of_the_chain_is_found_and_a_contradicting_one_refused():
    soft, stiff = CartesianImpedanceController(100.0), CartesianImpedanceController(800.0)
    tool = torch.cat([START, torch.zeros(6)]).expand(3, 13)
    env = scripted(tool, soft)
    env.reset()
    assert env.transform[-1]._controller() is soft
    assert scripted(tool, soft, controller=CartesianImpedanceController(100.0)).reset() is not None
    with pytest.raises(ValueError, match="other gains than that of the ImpedanceTransform"):
        scripted(tool, soft, controller=stiff).reset()


def test_without_a_controller_anywhere_the_error_says_what_to_do():
    env = TransformedEnv(MockArmEnv((2,), action_shape=(13,)), ReferenceGovernorTransform())
    with pytest.raises(ValueError, match=r"finds no ImpedanceTransform .* pass controller="):
        env.reset()


def test_a_governor_after_a_macro_step_or_on_another_action_is_refused():
    controller = CartesianImpedanceController()
    chain = Compose(ImpedanceTransform(controller), MacroStepTransform(5), ReferenceGovernorTransform())
    with pytest.raises(ValueError, match="stands after a MacroStepTransform"):
        TransformedEnv(MockArmEnv((2,), action_shape=(6,)), chain).reset()
    with pytest.raises(ValueError, match=r"the action 'action' has shape .*; expected \(\*batch, 13\)"):
        TransformedEnv(MockArmEnv((2,)), ReferenceGovernorTransform(controller=controller)).full_action_spec  # noqa: B018


def test_every_reference_of_a_chunk_passes_the_governor():
    env = TransformedEnv(
        MockArmEnv((2,), action_shape=(6,)),
        Compose(
            ImpedanceTransform(CartesianImpedanceController()), ReferenceGovernorTransform(1.0, 0.1),
            MacroStepTransform(5, trace_keys=["executed", "twist", "governor_lag"]), make_promp_transform(),
        ),
    )  # fmt: skip
    assert any(isinstance(t, ProMPTransform) for t in env.transform)
    trace = play(env, actions_for(env, 1, scale=3.0))["next", "trace"]
    assert trace["governor_lag"].shape == (2, 1, 5, 2)
    assert (trace["governor_lag"][..., 0] > 0).all()


def test_learnable_gains_get_gradients_through_the_governor():
    controller = CartesianImpedanceController(learnable=True)
    governor = ReferenceGovernorTransform(5.0, 0.5, controller=controller, dt=0.01)
    td = MockArmEnv((2,), action_shape=(13,)).reset().set("action", references(1, 2))
    governor.inv(td)["action"].square().sum().backward()
    assert all(gain.grad.isfinite().all() and gain.grad.any() for gain in governor.parameters())


def test_on_the_arm_a_blocked_reference_presses_with_no_more_than_the_limit_where_the_plain_impedance_presses_harder():
    def pressed(*layers):
        env = push_env(
            1, JointTorqueTransform(Kinematics(PANDA, PandaPushEnv.tool.length)),
            ImpedanceTransform(CartesianImpedanceController()), *layers, duration=1.0, engine=COARSE,
        )  # fmt: skip
        td = env.reset()
        wall = td["pose"].clone()
        force = []
        for _ in range(60):  # a reference 20 cm above: the wrench of the chain at the beginning of the motion
            reference = torch.cat([wall, torch.zeros(1, 6)], -1)
            reference[:, 2] += 0.2
            td["action"] = reference
            force.append(env.transform.inv(td.clone())["action"].abs().amax().item())
            td = env.step(td)["next"]
        return max(force), td["pose"][0, 2].item() - wall[0, 2].item()

    plain, rose = pressed()
    gentle, too = pressed(ReferenceGovernorTransform(10.0))
    assert gentle < 0.5 * plain
    assert rose > 0.15
    assert 0.02 < too < rose
