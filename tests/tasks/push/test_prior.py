from __future__ import annotations

import torch

from ppt_rl.modules import ProMP
from ppt_rl.tasks.push.prior import PUSH_AXES, fit_push_prior, minimum_jerk, push_demonstrations


def test_minimum_jerk_starts_and_ends_at_rest_and_is_symmetric():
    s = torch.linspace(0, 1, 101, dtype=torch.float64)
    y = minimum_jerk(s)
    torch.testing.assert_close(y + y.flip(0), torch.ones_like(y))
    ends = torch.tensor([0.0, 1.0], dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(minimum_jerk(ends).sum(), ends, create_graph=True)
    (curvature,) = torch.autograd.grad(slope.sum(), ends)
    assert slope.abs().max() == 0
    assert curvature.abs().max() == 0


def test_demonstrations_pass_through_their_via_points():
    phase = torch.tensor([[0.0, 0.4, 1.0]]).expand(5, 3)
    position = torch.randn(5, 3, 2)
    path = push_demonstrations(phase, position, num_samples=101)
    torch.testing.assert_close(path[:, [0, 40, 100]], position)


def test_the_prior_of_pushing_is_fitted_not_typed_in_and_repeats_with_its_seed():
    promps = [fit_push_prior(ProMP(8, len(PUSH_AXES), 3.0), num_demonstrations=64, seed=s) for s in (0, 0, 1)]
    assert torch.equal(promps[0].weights_cov, promps[1].weights_cov)
    assert not torch.equal(promps[0].weights_cov, promps[2].weights_cov)
    start, _, end = promps[0].decode(promps[0].weights_mean, torch.tensor([0.0, 0.5, 1.0]))[0]
    assert abs(start[0] - 0.36) < 0.01
    assert 0.58 < end[0] < 0.64  # goals from 0.60 to 0.70, less the offset of the box
