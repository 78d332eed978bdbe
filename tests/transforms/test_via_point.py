from __future__ import annotations

import pytest
import torch
from torchrl.envs import TransformedEnv

from ppt_rl.functional.promp import unvec
from ppt_rl.transforms import ViaPointTransform
from tests.transforms.cases import make_promp, push_env
from tests.transforms.mocks import MockArmEnv, actions_for, play


@pytest.mark.parametrize("prefix", [(), ("agent",), ("agent", "task")], ids=str)
def test_the_written_posterior_is_the_primitives_own_at_reset_and_at_every_step(prefix):
    promp = make_promp()
    env = TransformedEnv(MockArmEnv((2,), prefix=prefix), ViaPointTransform(promp, write_cov=True, prefix=prefix))
    steps = play(env, actions_for(env, 4))

    def key(name):
        return (*prefix, name)

    for td in (steps, steps["next"]):
        via = [td[key(f"via_{name}")] for name in ("phase", "position", "cov", "mask")]
        posterior = promp.posterior(*via)
        torch.testing.assert_close(td[key("weights_mean")], unvec(posterior.mean, 4).float())
        torch.testing.assert_close(td[key("weights_cov")], posterior.cov.float())


def test_the_posterior_passes_near_exact_via_points():
    promp = make_promp()
    td = MockArmEnv((2,)).reset()
    td["via_cov"] = 1e-10 * torch.eye(3).expand(2, 2, 3, 3)
    out = ViaPointTransform(promp)(td)
    reached = promp.decode(out["weights_mean"], out["via_phase"])[0]
    torch.testing.assert_close(reached, out["via_position"], rtol=0, atol=1e-4)


def test_fully_masked_via_points_give_the_prior():
    promp = make_promp()
    td = MockArmEnv((2,)).reset()
    td["via_mask"] = torch.tensor([[True, True], [False, False]])
    out = ViaPointTransform(promp, write_cov=True)(td)
    assert torch.equal(out["weights_mean"][1], promp.weights_mean)
    assert torch.equal(out["weights_cov"][1], promp.weights_cov)
    assert not torch.allclose(out["weights_mean"][0], promp.weights_mean)


def test_via_velocities_are_used_where_they_are_there():
    promp = make_promp()
    td = MockArmEnv((2,)).reset()
    td["via_velocity"] = torch.tensor([[[0.1, -0.2, 0.3]]]).expand(2, 2, 3).clone()
    td["via_velocity_cov"] = 1e-10 * torch.eye(3).expand(2, 2, 3, 3)
    td["via_cov"] = 1e-6 * torch.eye(3).expand(2, 2, 3, 3)
    out = ViaPointTransform(promp)(td)
    velocity = promp.decode(out["weights_mean"], out["via_phase"])[1]
    torch.testing.assert_close(velocity, out["via_velocity"], rtol=0, atol=1e-3)


def test_the_covariance_is_written_on_request_only():
    promp = make_promp()
    assert "weights_cov" not in ViaPointTransform(promp)(MockArmEnv((2,)).reset()).keys()
    assert ViaPointTransform(promp, write_cov=True)(MockArmEnv((2,)).reset())["weights_cov"].shape == (2, 12, 12)


def test_the_via_points_of_the_pushing_task_are_followed_to_their_accuracy():
    promp = make_promp()
    promp.weights_cov.copy_(torch.eye(12))
    td = push_env(2, ViaPointTransform(promp)).reset()
    reached = promp.decode(td["weights_mean"], td["via_phase"])[0]
    error = (reached - td["via_position"]).abs()
    std = td["via_cov"].diagonal(dim1=-2, dim2=-1).sqrt()
    assert (error < 3 * std).all()


@pytest.mark.parametrize("key", ["via_phase", "via_position", "via_cov"])
def test_a_missing_entry_is_named_with_what_there_is(key):
    td = MockArmEnv((2,)).reset().exclude(key)
    with pytest.raises(KeyError, match=rf"ViaPointTransform needs .*{key}.*holds .*count"):
        ViaPointTransform(make_promp())(td)


def test_via_points_of_another_shape_are_refused():
    td = MockArmEnv((2,)).reset()
    td["via_position"] = td["via_position"][..., :2]
    with pytest.raises(ValueError, match="expected"):
        ViaPointTransform(make_promp())(td)
