from __future__ import annotations

import pytest
import torch
from torchrl.envs import TransformedEnv

from ppt_rl.modules import ProMP, TaskSpace
from ppt_rl.transforms import ProMPTransform, ViaPointTransform
from tests.transforms.cases import AXES, ORIGIN, make_promp, make_promp_transform
from tests.transforms.mocks import MockArmEnv, actions_for, play


def make_env(promp, replan_steps, batch=(2,), via_points=False, **kwargs):
    steps = round(promp.duration / 0.01) if replan_steps is None else replan_steps
    base = MockArmEnv(batch, action_shape=(steps, 13), horizons=(1000,))
    transform = ProMPTransform(promp, TaskSpace(AXES, ORIGIN), replan_steps=replan_steps, **kwargs)
    env = TransformedEnv(base, transform)
    return env.append_transform(ViaPointTransform(promp)) if via_points else env


def corrected(promp, weights, position, velocity, phase=0.0):
    """Nearest weights through a position and a velocity, by least norm."""
    value, first, _ = promp.basis(torch.tensor([phase], dtype=torch.float64))
    rows = torch.cat([value, first / promp.duration])
    wanted = torch.stack([position, velocity], -2).double()
    return weights.double() + torch.linalg.pinv(rows) @ (wanted - rows @ weights.double())


@pytest.mark.parametrize("via_points", [False, True])
@pytest.mark.parametrize(("replan_steps", "residuals"), [(75, 4), (1, 12), (37, 8)])
def test_position_and_velocity_of_the_reference_are_continuous_at_every_replan(replan_steps, residuals, via_points):
    promp = make_promp(duration=3.0, num_basis=8)
    env = make_env(promp, replan_steps, via_points=via_points)
    steps = play(env, actions_for(env, residuals, scale=2.0))["next"]
    assert (steps["weights"].diff(dim=1).abs().amax((-1, -2)) > 1e-2).all()
    for k in range(residuals - 1):
        border = steps["phase"][:, k]
        old = promp.decode(steps["weights"][:, k], border)
        new = promp.decode(steps["weights"][:, k + 1], border)
        torch.testing.assert_close(old[0], new[0], rtol=0, atol=1e-5)
        torch.testing.assert_close(old[1], new[1], rtol=0, atol=1e-5)


def test_the_executed_references_go_on_where_the_last_chunk_ended():
    promp, space = make_promp(duration=3.0, num_basis=8), TaskSpace(AXES, ORIGIN)
    env = make_env(promp, 75)
    steps = play(env, actions_for(env, 4, scale=2.0))["next"]
    first = steps["executed"][:, 1:, 0]
    torch.testing.assert_close(first[..., :7], space.pose(steps["reference_position"][:, :-1]), rtol=0, atol=1e-5)
    torch.testing.assert_close(first[..., 7:], space.twist(steps["reference_velocity"][:, :-1]), rtol=0, atol=1e-5)


def test_the_first_reference_is_the_measured_pose_at_rest():
    env = make_env(make_promp(duration=3.0, num_basis=8), 75)
    steps = play(env, actions_for(env, 1, scale=2.0))
    space = TaskSpace(AXES, ORIGIN)
    first = steps["next", "executed"][:, 0, 0]
    torch.testing.assert_close(first[:, :7], space.pose(space.project(steps["pose"][:, 0])), rtol=0, atol=1e-5)
    torch.testing.assert_close(first[:, 7:], torch.zeros(2, 6), rtol=0, atol=1e-5)


def test_a_chunk_is_the_decoded_trajectory_at_the_phases_of_its_control_steps():
    promp, space = make_promp(duration=3.0, num_basis=8), TaskSpace(AXES, ORIGIN)
    env = make_env(promp, 75)
    steps = play(env, actions_for(env, 4))["next"]
    phases = torch.arange(300).reshape(4, 75) / 300
    for k in range(4):
        position, velocity, _ = promp.decode(steps["weights"][:, k], phases[k])
        expected = torch.cat([space.pose(position), space.twist(velocity)], -1)
        torch.testing.assert_close(steps["executed"][:, k], expected, rtol=0, atol=1e-5)
    torch.testing.assert_close(steps["phase"][0].flatten(), torch.tensor((0.25, 0.5, 0.75, 1.0)))


def test_a_zero_residual_without_via_points_is_the_prior_mean_joined_at_the_start():
    promp = make_promp(duration=3.0, num_basis=8)
    env = make_env(promp, None)
    steps = play(env, torch.zeros(1, 2, 24))
    start = TaskSpace(AXES, ORIGIN).project(steps["pose"][:, 0])
    expected = corrected(promp, promp.weights_mean, start, torch.zeros_like(start))
    torch.testing.assert_close(steps["next", "weights"][:, 0].double(), expected, rtol=0, atol=1e-6)


def test_a_zero_residual_is_exactly_the_prior_mean_where_it_already_begins_at_the_pose_at_rest():
    promp = make_promp(duration=3.0, num_basis=8)
    env = make_env(promp, 100, batch=(1,))
    start = TaskSpace(AXES, ORIGIN).project(env.reset()["pose"])[0]
    promp.weights_mean.copy_(corrected(promp, promp.weights_mean, start, torch.zeros(3)))
    env.set_seed(0)
    weights = play(env, torch.zeros(3, 1, 24))["next", "weights"][0]
    torch.testing.assert_close(weights, promp.weights_mean.expand(3, 8, 3), rtol=0, atol=1e-5)


def test_the_residual_moves_each_coordinate_by_its_own_scale():
    promp = make_promp(duration=3.0, num_basis=8)
    env = make_env(promp, None, residual_scale=(0.1, 0.2, 0.3))
    generator = torch.Generator().manual_seed(0)
    residual = torch.randn(8, 3, generator=generator)
    vec = residual.T.reshape(1, 24)  # column by column
    steps = play(env, vec.expand(1, 2, 24))
    start = TaskSpace(AXES, ORIGIN).project(steps["pose"][:, 0])
    moved = promp.weights_mean + torch.tensor((0.1, 0.2, 0.3)) * residual
    expected = corrected(promp, moved, start, torch.zeros_like(start))
    torch.testing.assert_close(steps["next", "weights"][:, 0].double(), expected, rtol=0, atol=1e-6)


def test_the_observed_posterior_mean_replaces_the_prior_mean():
    promp = make_promp(duration=3.0, num_basis=8)
    env = make_env(promp, None, via_points=True)
    steps = play(env, torch.zeros(1, 2, 24))
    start = TaskSpace(AXES, ORIGIN).project(steps["pose"][:, 0])
    expected = torch.stack(
        [
            corrected(promp, mean, position, torch.zeros(3))
            for mean, position in zip(steps["weights_mean"][:, 0], start, strict=True)
        ]
    )
    assert (steps["weights_mean"][:, 0] - promp.weights_mean).abs().max() > 1e-2
    torch.testing.assert_close(steps["next", "weights"][:, 0].double(), expected, rtol=0, atol=1e-6)


def test_past_the_end_the_reference_rests_where_it_is():
    promp, space = make_promp(duration=0.1), TaskSpace(AXES, ORIGIN)
    env = make_env(promp, 6)
    steps = play(env, actions_for(env, 2))["next"]
    past = steps["executed"][:, 1, 5:]  # control step 11 of 10
    end = promp.decode(steps["weights"][:, 1], torch.ones(2, 1))[0]
    torch.testing.assert_close(past[..., :7], space.pose(end), rtol=0, atol=1e-6)
    assert not past[..., 7:].any()
    assert (steps["phase"][:, 1] == 1).all()
    assert not steps["reference_velocity"][:, 1].any()


@pytest.mark.parametrize("size", [11, 13, 3])
def test_an_action_of_another_size_than_the_weights_is_refused(size):
    env = TransformedEnv(MockArmEnv((2,), action_shape=(5, 13)), make_promp_transform())
    with pytest.raises(ValueError, match=r"residual.*expected \(\*batch, 12\)"):
        env.step(env.reset().set("action", torch.zeros(2, size)))


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_an_action_that_is_not_finite_is_refused(bad):
    env = TransformedEnv(MockArmEnv((2,), action_shape=(5, 13)), make_promp_transform())
    action = torch.zeros(2, 12)
    action[1, 4] = bad
    with pytest.raises(ValueError, match="holds 1 NaN or infinite"):
        env.step(env.reset().set("action", action))


@pytest.mark.parametrize("replan_steps", [0, -1, 11])
def test_replan_steps_outside_the_duration_are_refused(replan_steps):
    with pytest.raises(ValueError, match=r"replan_steps is .*expected (1 to 10|a whole number of at least 1)"):
        make_promp_transform(replan_steps=replan_steps, dt=0.01)


@pytest.mark.parametrize("dt", [0.03, 0.2, 0.0, -0.01, float("nan")])
def test_a_control_step_that_does_not_divide_the_duration_is_refused(dt):
    with pytest.raises(ValueError, match="dt"):
        make_promp_transform(dt=dt, replan_steps=None)


@pytest.mark.parametrize("scale", [0.0, -1.0, (0.1, 0.2), (0.1, 0.2, -0.1), (0.0,) * 3, (0.1,) * 4])
def test_a_residual_scale_that_does_not_fit_is_refused(scale):
    with pytest.raises(ValueError, match="residual_scale"):
        make_promp_transform(residual_scale=scale)


def test_a_coordinate_without_a_residual_is_left_to_the_reference():
    promp = make_promp()
    transform = make_promp_transform(residual_scale=(0.1, 0.0, 0.2))
    assert transform.residual_scale.tolist() == pytest.approx([0.1, 0.0, 0.2])
    env = make_env(promp, None, residual_scale=(0.1, 0.0, 0.2))
    root = env.reset()
    size = env.full_action_spec["action"].shape[-1]
    still, moved = (
        env.step(root.clone().set("action", torch.full((*env.batch_size, size), value)))["next"] for value in (0.0, 1.0)
    )
    difference = (moved["weights"] - still["weights"]).abs().flatten(0, -2).amax(0)
    assert difference[1] == 0
    assert (difference[[0, 2]] > 0.05).all()


def test_a_primitive_with_other_degrees_of_freedom_than_the_task_space_is_refused():
    with pytest.raises(ValueError, match="2 degrees of freedom"):
        ProMPTransform(ProMP(4, 2, 0.1), TaskSpace(AXES, ORIGIN))
