from itertools import pairwise

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from ppt_rl.functional.promp import Gaussian, basis, spread_centres, unvec, vec
from ppt_rl.functional.promp_fit import fit_em, fit_ridge
from tests.sampling import normal, random_gaussian

F64 = torch.float64


def demonstrations(num: int, steps: int, noise: float = 0.0, seed: int = 0) -> tuple[Gaussian, Tensor, Tensor]:
    """A prior over 4 x 2 weights, weights drawn from it, and their trajectories with noise."""
    prior = random_gaussian(8, seed=seed)
    weights = prior.mean + normal(num, 8, seed=seed + 2) @ torch.linalg.cholesky(prior.cov).mT
    phi = basis(torch.linspace(0, 1, steps, dtype=F64), *spread_centres(4))[0]
    return Gaussian(prior.mean, prior.cov), phi, phi @ unvec(weights, 4) + noise * normal(num, steps, 2, seed=seed + 3)


def assert_within_sampling_error(fitted: Gaussian, prior: Gaussian, num: int, sigmas: float = 4.5) -> None:
    """Mean and covariance of ``num`` draws are off by no more than ``sigmas`` standard errors."""
    variance = prior.cov.diagonal()
    assert bool(((fitted.mean - prior.mean).abs() <= sigmas * (variance / num).sqrt()).all())
    spread = ((variance[:, None] * variance + prior.cov.square()) / num).sqrt()
    assert bool(((fitted.cov - prior.cov).abs() <= sigmas * spread).all())


def test_ridge_regression_of_noiseless_demonstrations_gives_the_moments_of_their_weights():
    prior, phi, y = demonstrations(500, 40)
    fitted = fit_ridge(y, phi, ridge=1e-12)
    weights = vec(torch.linalg.pinv(phi) @ y)
    assert_close(fitted.mean, weights.mean(0), rtol=0.0, atol=1e-8)
    assert_close(fitted.cov, torch.cov(weights.mT), rtol=0.0, atol=1e-8)
    assert_within_sampling_error(fitted, prior, 500)


def test_expectation_maximisation_agrees_with_ridge_regression_on_noiseless_demonstrations_of_equal_length():
    _, phi, y = demonstrations(200, 40)
    ridge = fit_ridge(y, phi, ridge=1e-9)
    em, noise = fit_em(y, torch.ones(200, 40, dtype=torch.bool), phi.expand(200, -1, -1), ridge=1e-9)
    assert_close(em.mean, ridge.mean, rtol=0.0, atol=1e-5)
    assert_close(em.cov, ridge.cov * 199 / 200, rtol=0.0, atol=1e-4)  # maximum likelihood divides by N
    assert noise.item() < 1e-7


def test_expectation_maximisation_recovers_prior_and_noise_from_gaps_and_differing_lengths():
    prior, phi, y = demonstrations(500, 40, noise=0.05)
    generator = torch.Generator().manual_seed(0)
    length = torch.randint(15, 41, (500, 1), generator=generator)
    mask = (torch.arange(40) < length) & (torch.rand(500, 40, generator=generator) < 0.9)
    fitted, noise = fit_em(y, mask, phi.expand(500, -1, -1), ridge=1e-9)
    # 500 demonstrations, many cut short: the errors are those of about half as many whole ones.
    assert_within_sampling_error(fitted, prior, 250)
    assert noise.item() == pytest.approx(0.05**2, rel=0.05)


def test_samples_that_are_not_under_the_mask_have_no_effect():
    _, phi, y = demonstrations(20, 40, noise=0.05)
    mask = torch.arange(40) < torch.randint(15, 41, (20, 1), generator=torch.Generator().manual_seed(0))
    junk = torch.where(mask.unsqueeze(-1), y, 1e6)
    clean = fit_em(y, mask, phi.expand(20, -1, -1), ridge=1e-6)
    assert_close(fit_em(junk, mask, phi.expand(20, -1, -1), ridge=1e-6), clean)


def test_every_iteration_of_expectation_maximisation_raises_the_likelihood():
    _, phi, y = demonstrations(12, 20, noise=0.2)
    mask = torch.arange(20) < torch.randint(6, 21, (12, 1), generator=torch.Generator().manual_seed(0))

    def log_likelihood(fitted: Gaussian, noise: Tensor) -> float:
        total = 0.0
        for row, keep in zip(y, mask, strict=True):
            h = torch.kron(torch.eye(2, dtype=F64), phi[keep])
            cov = h @ fitted.cov @ h.mT + noise * torch.eye(len(h), dtype=F64)
            model = torch.distributions.MultivariateNormal(h @ fitted.mean, cov)
            total += model.log_prob(vec(row[keep])).item()
        return total

    values = [
        log_likelihood(*fit_em(y, mask, phi.expand(12, -1, -1), ridge=1e-10, iterations=n, tolerance=0.0))
        for n in (1, 2, 3, 5, 10)
    ]
    assert all(later >= earlier - 1e-6 for earlier, later in pairwise(values))
