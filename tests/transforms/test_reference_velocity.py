"""A step-wise policy around a reference."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close
from torchrl.envs import Compose, TransformedEnv

from ppt_rl.modules import ProMP, TaskSpace
from ppt_rl.transforms import (
    CartesianVelocityTransform,
    HoldActionTransform,
    MacroStepTransform,
    ReferenceVelocityTransform,
)
from tests.transforms.cases import AXES, ORIGIN, make_promp
from tests.transforms.mocks import MockArmEnv

F64 = torch.float64
DT = 0.01
LIMIT = 50.0


def follow(steps: int = 10, **kwargs: object) -> ReferenceVelocityTransform:
    """Fast enough that nothing is clipped."""
    return ReferenceVelocityTransform(make_promp(steps * DT), **{"max_velocity": LIMIT, "dt": DT, **kwargs})


def total(transform: ReferenceVelocityTransform, action: torch.Tensor, **entries: torch.Tensor) -> torch.Tensor:
    return transform.inv(TensorDict(action=action, batch_size=action.shape[:1], **entries))["action"]


def test_an_action_of_zero_adds_up_to_the_path_of_the_reference():
    transform = follow()
    velocity = LIMIT * total(transform, torch.zeros(2, 10, 3))
    start, end = transform.promp.decode(transform.promp.weights_mean.float(), torch.tensor([0.0, 1.0]))[0]
    assert_close(DT * velocity.sum(-2), (end - start).expand(2, 3), atol=1e-5, rtol=1e-5)


def test_the_weights_of_the_via_points_go_before_the_mean_of_the_prior():
    transform, weights = follow(), 0.3 * torch.randn(2, 4, 3)
    velocity = LIMIT * total(transform, torch.zeros(2, 10, 3), weights_mean=weights)
    start, end = transform.promp.decode(weights, torch.tensor([0.0, 1.0]))[0].unbind(-2)
    assert_close(DT * velocity.sum(-2), end - start, atol=1e-5, rtol=1e-5)


def test_the_policy_adds_its_share_and_the_sum_stays_within_the_limit():
    transform, action = follow(scale=0.25), torch.rand(2, 10, 3) * 2 - 1
    alone = total(transform, torch.zeros_like(action))
    assert_close(total(transform, action), (alone + 0.25 * action).clamp(-1, 1))
    slow = follow(max_velocity=1e-3)
    assert (total(slow, action).abs() == 1).float().mean() > 0.9
    assert total(slow, action).abs().max() <= 1


def test_the_reference_stands_still_past_its_end():
    assert (total(follow(steps=4), torch.zeros(2, 10, 3))[:, 4:] == 0).all()
    assert (total(follow(steps=4), torch.zeros(2, 10, 3))[:, :4] != 0).all()


def held(num_steps: int = 4) -> TransformedEnv:
    promp = make_promp(20 * DT)
    space = TaskSpace(AXES, ORIGIN)
    return TransformedEnv(
        MockArmEnv((2,), horizons=(100,), action_shape=(13,)),
        Compose(
            CartesianVelocityTransform(space, max_velocity=LIMIT, max_lead=100.0),
            MacroStepTransform(num_steps),
            ReferenceVelocityTransform(promp, max_velocity=LIMIT),
            HoldActionTransform(num_steps),
        ),
    )


@pytest.mark.parametrize("num_steps", [1, 4, 5])
def test_however_often_it_decides_a_policy_of_zeros_draws_the_same_path(num_steps: int):
    env = held(num_steps)
    dt = env.base_env.control_dt
    promp: ProMP = env.transform[2].promp
    root = env.reset()
    first = root["reference_position"]
    count = 20 // num_steps
    for _ in range(count):
        root = env.step_mdp(env.step(root.set("action", torch.zeros(2, 3))))
    phase = min(1.0, count * num_steps * dt / promp.duration)
    assert_close(root["phase"], torch.full((2, 1), phase))
    start, end = promp.decode(promp.weights_mean.float(), torch.tensor([0.0, phase]))[0]
    assert_close(root["reference_position"][:, :2], (first + end - start)[:, :2], atol=1e-4, rtol=1e-4)


def test_a_reset_begins_the_reference_anew_in_the_environments_that_reset_only():
    env = held()
    root = env.step_mdp(env.step(env.reset().set("action", torch.zeros(2, 3))))
    reached = root["phase"].clone()
    root["_reset"] = torch.tensor([[True], [False]])
    assert_close(env.reset(root)["phase"], reached * torch.tensor([[0.0], [1.0]]))


def test_it_is_refused_where_no_macro_step_executes_a_chunk():
    chain = Compose(CartesianVelocityTransform(TaskSpace(AXES, ORIGIN)), follow(dt=None))
    with pytest.raises(ValueError, match=r"expected a chunk .*MacroStepTransform"):
        TransformedEnv(MockArmEnv((2,), action_shape=(13,)), chain).reset()


@pytest.mark.parametrize("wrong", [{"scale": 0.0}, {"scale": 1.5}, {"max_velocity": 0.0}, {"max_velocity": (1.0, 2.0)}])
def test_impossible_numbers_are_refused(wrong: dict):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        follow(**wrong)


@pytest.mark.parametrize("bad", [torch.zeros(1, 10, 2), torch.full((1, 10, 3), torch.nan)])
def test_an_action_of_another_shape_or_that_is_not_finite_is_refused(bad: torch.Tensor):
    with pytest.raises(ValueError, match=r"action \(velocities\)"):
        total(follow(), bad)
