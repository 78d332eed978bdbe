import math

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from ppt_rl.functional.promp import Gaussian, basis, unvec, vec
from ppt_rl.modules import ProMP
from tests.modules.conftest import DURATION, SIZE, D, K
from tests.sampling import normal, random_cov

F64 = torch.float64
M = 4
TIGHT = {"rtol": 0.0, "atol": 1e-12}


def via_points(*batch: int, seed: int = 0) -> dict[str, Tensor]:
    """M via-points: positions and velocities, each with its covariance."""
    phase = torch.rand(*batch, M, generator=torch.Generator().manual_seed(seed), dtype=F64)
    return {
        "via_phase": phase,
        "via_position": normal(*batch, M, D, seed=seed + 1),
        "via_cov": random_cov(*batch, M, size=D, scale=0.01, seed=seed + 2),
        "via_velocity": normal(*batch, M, D, seed=seed + 3),
        "via_velocity_cov": random_cov(*batch, M, size=D, scale=0.1, seed=seed + 4),
    }


def information_form(
    promp: ProMP, via: dict[str, Tensor], use: list[int], use_velocity: list[int], prior: Gaussian | None = None
) -> Gaussian:
    """The posterior in information form, adding one via-point after the other."""
    mean, cov = promp.prior if prior is None else prior
    precision = torch.linalg.inv(cov)
    right = precision @ mean
    value, first, _ = promp.basis(via["via_phase"])
    eye = torch.eye(D, dtype=F64)
    terms = [(value[m], via["via_position"][m], via["via_cov"][m]) for m in use]
    terms += [(first[m] / DURATION, via["via_velocity"][m], via["via_velocity_cov"][m]) for m in use_velocity]
    for row, y, noise in terms:
        h = torch.kron(eye, row.unsqueeze(0))
        precision = precision + h.mT @ torch.linalg.solve(noise, h)
        right = right + h.mT @ torch.linalg.solve(noise, y)
    return Gaussian(torch.linalg.solve(precision, right), torch.linalg.inv(precision))


def positions_only(via: dict[str, Tensor]) -> dict[str, Tensor]:
    return {key: value for key, value in via.items() if "velocity" not in key}


def test_decoded_velocity_and_acceleration_are_the_time_derivatives(promp):
    weights, phase = normal(5, K, D), torch.linspace(0, 1, 21, dtype=F64)
    h = 1e-4  # [s]
    before, at, after = (promp.decode(weights, phase + shift / DURATION) for shift in (-h, 0.0, h))
    assert_close(at[1], (after[0] - before[0]) / (2 * h), rtol=0.0, atol=1e-5)
    assert_close(at[2], (after[1] - before[1]) / (2 * h), rtol=0.0, atol=1e-4)


def test_constant_weights_give_a_trajectory_at_rest(promp):
    position, velocity, acceleration = promp.decode(torch.full((K, D), 0.7).double(), torch.rand(9, dtype=F64))
    assert_close(position, torch.full((9, D), 0.7).double(), rtol=0.0, atol=1e-7)
    assert_close(velocity, torch.zeros(9, D, dtype=F64), **TIGHT)
    assert_close(acceleration, torch.zeros(9, D, dtype=F64), rtol=0.0, atol=1e-10)


@pytest.mark.parametrize("batch", [(), (4,), (2, 4)])
def test_decoding_a_batch_with_its_own_phases_equals_single_calls(promp, batch):
    weights, phase = normal(*batch, K, D), torch.rand(*batch, 7, dtype=F64)
    parts = promp.decode(weights, phase)
    rows = [promp.decode(w, p) for w, p in zip(weights.reshape(-1, K, D), phase.reshape(-1, 7), strict=True)]
    for part, *singles in zip(parts, *rows, strict=True):
        assert part.shape == (*batch, 7, D)
        assert_close(part.reshape(-1, 7, D), torch.stack(singles))


def test_the_basis_uses_the_modules_centres_and_widths():
    centres, widths = torch.tensor([0.0, 0.3, 1.0]), torch.tensor([0.1, 0.2, 0.3])
    phase = torch.rand(5)
    promp = ProMP(3, 1, 1.0, centres=centres, widths=widths)
    assert_close(promp.basis(phase), basis(phase, centres, widths))


def test_the_prior_is_standard_normal_before_it_is_fitted():
    mean, cov = ProMP(K, D, DURATION).prior
    assert torch.equal(mean, torch.zeros(SIZE))
    assert torch.equal(cov, torch.eye(SIZE))


def test_the_posterior_under_positions_equals_the_information_form(promp):
    via = via_points()
    expected = information_form(promp, via, use=[0, 1, 2, 3], use_velocity=[])
    assert_close(promp.posterior(**positions_only(via)), expected, rtol=0.0, atol=1e-6)


def test_the_posterior_under_positions_and_velocities_equals_the_information_form(promp):
    via = via_points()
    expected = information_form(promp, via, use=[0, 1, 2, 3], use_velocity=[0, 1, 2, 3])
    assert_close(promp.posterior(**via), expected, rtol=0.0, atol=1e-6)


def test_positions_and_velocities_have_separate_masks(promp):
    via = via_points()
    mask, velocity_mask = torch.tensor([True, False, True, False]), torch.tensor([False, True, True, False])
    expected = information_form(promp, via, use=[0, 2], use_velocity=[1, 2])
    posterior = promp.posterior(**via, via_mask=mask, via_velocity_mask=velocity_mask)
    assert_close(posterior, expected, rtol=0.0, atol=1e-6)


def test_velocities_take_the_mask_of_the_positions_by_default(promp):
    via, mask = via_points(), torch.tensor([True, False, True, False])
    explicit = promp.posterior(**via, via_mask=mask, via_velocity_mask=mask)
    assert_close(promp.posterior(**via, via_mask=mask), explicit, rtol=0.0, atol=0.0)


def test_a_masked_batch_equals_unmasked_single_solves(promp):
    via = via_points(8)
    mask = torch.tensor([[bool(i >> m & 1) for m in range(M)] for i in (1, 2, 3, 5, 7, 8, 14, 15)])
    batched = promp.posterior(**via, via_mask=mask)
    for i, keep in enumerate(mask):
        single = promp.posterior(**{key: value[i][keep] for key, value in via.items()})
        assert_close(Gaussian(batched.mean[i], batched.cov[i]), single, rtol=0.0, atol=1e-9)


def test_the_order_of_via_points_is_irrelevant(promp):
    via, order = via_points(5), torch.tensor([2, 0, 3, 1])
    shuffled = {key: value[:, order] for key, value in via.items()}
    assert_close(promp.posterior(**shuffled), promp.posterior(**via), rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_when_all_via_points_are_masked_the_posterior_is_exactly_the_prior(promp, dtype):
    via, mask = via_points(3), torch.zeros(3, M, dtype=torch.bool)
    module = promp.to(dtype)
    mean, cov = module.posterior(**via, via_mask=mask)
    assert torch.equal(mean, module.prior.mean.expand(3, SIZE))
    assert torch.equal(cov, module.prior.cov.expand(3, SIZE, SIZE))


@pytest.mark.parametrize("variance", [0.0, 1e-10])
def test_via_points_with_a_tiny_covariance_are_passed_through(promp, variance):
    via = via_points(3)
    via["via_phase"] = torch.tensor([0.1, 0.35, 0.7, 0.95], dtype=F64).expand(3, M)
    via["via_cov"] = variance * torch.eye(D, dtype=F64).expand(3, M, D, D)
    mean, cov = promp.posterior(**positions_only(via))
    position, _, _ = promp.decode(unvec(mean, K), via["via_phase"])
    assert_close(position, via["via_position"], rtol=0.0, atol=1e-6)
    assert bool((cov.diagonal(dim1=-2, dim2=-1) < promp.prior.cov.diagonal()).all())


def test_position_and_velocity_of_one_exact_via_point_are_both_met(promp):
    via = {key: value[:1] for key, value in via_points().items()}
    via["via_cov"], via["via_velocity_cov"] = (torch.zeros(1, D, D, dtype=F64) for _ in range(2))
    position, velocity, _ = promp.decode(unvec(promp.posterior(**via).mean, K), via["via_phase"])
    assert_close(position, via["via_position"], rtol=0.0, atol=1e-8)
    assert_close(velocity, via["via_velocity"], rtol=0.0, atol=1e-8)


@pytest.mark.parametrize("variance", [0.0, 1e-8, 1e-2])
def test_the_posterior_covariance_is_symmetric_psd_and_no_larger_than_the_prior(promp, variance):
    via = via_points(5)
    via["via_cov"] = variance * torch.eye(D, dtype=F64).expand(5, M, D, D)
    cov = promp.posterior(**via).cov
    assert_close(cov, cov.mT, rtol=0.0, atol=1e-9)
    assert torch.linalg.eigvalsh(cov).min().item() > -1e-9
    assert torch.linalg.eigvalsh(promp.prior.cov - cov).min().item() > -1e-9


def test_a_given_prior_replaces_the_modules_own_row_by_row(promp):
    via = via_points()
    prior = Gaussian(normal(3, SIZE, seed=8), random_cov(3, size=SIZE, seed=9))
    posterior = promp.posterior(**via, prior=prior)
    for i in range(3):
        expected = information_form(promp, via, [0, 1, 2, 3], [0, 1, 2, 3], Gaussian(prior.mean[i], prior.cov[i]))
        assert_close(Gaussian(posterior.mean[i], posterior.cov[i]), expected, rtol=0.0, atol=1e-6)


def test_single_precision_is_close_to_double(promp):
    via = via_points(5)
    double = promp.posterior(**via)
    single = promp.float().posterior(**{key: value.float() for key, value in via.items()})
    assert single.mean.dtype == torch.float32
    assert_close(single.mean.double(), double.mean, rtol=0.0, atol=1e-3)


FIELDS = ["via_phase", "via_position", "via_cov", "via_velocity", "via_velocity_cov"]


@pytest.mark.parametrize("field", FIELDS)
@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_bad_number_in_a_used_via_point_raises(promp, field, bad):
    via = via_points(2)
    via[field][1, 2] = bad
    with pytest.raises(ValueError, match="NaN or infinite"):
        promp.posterior(**via)


@pytest.mark.parametrize("field", FIELDS)
@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_bad_number_in_a_masked_via_point_has_no_effect(promp, field, bad):
    via, mask = via_points(2), torch.ones(2, M, dtype=torch.bool)
    mask[1, 2] = False
    expected = promp.posterior(**via, via_mask=mask)
    via[field][1, 2] = bad
    assert_close(promp.posterior(**via, via_mask=mask), expected, rtol=0.0, atol=0.0)


def test_an_empty_set_of_via_points_is_refused(promp):
    via = {key: value[:, :0] for key, value in via_points(2).items()}
    with pytest.raises(ValueError, match=r"via-points are empty \(M = 0\)"):
        promp.posterior(**via)


def test_via_points_of_a_wrong_shape_are_refused(promp):
    via = positions_only(via_points(2))
    for key, wrong in (("via_position", via["via_position"][..., :2]), ("via_cov", via["via_cov"][:, :2])):
        with pytest.raises(ValueError, match=r"expected .* and \("):
            promp.posterior(**{**via, key: wrong})


def test_a_velocity_without_its_covariance_is_refused(promp):
    via = via_points(2)
    del via["via_velocity_cov"]
    with pytest.raises(ValueError, match="via_velocity came without via_velocity_cov"):
        promp.posterior(**via)


def test_samples_have_the_mean_and_covariance_of_the_prior(promp):
    num = 20_000
    weights = promp.sample(num, torch.Generator().manual_seed(0))
    assert weights.shape == (num, K, D)
    drawn, (mean, cov) = vec(weights), promp.prior
    variance = cov.diagonal()
    # Five standard errors of the moments of normal samples.
    assert bool(((drawn.mean(0) - mean).abs() <= 5 * (variance / num).sqrt()).all())
    spread = ((variance[:, None] * variance + cov.square()) / num).sqrt()
    assert bool(((torch.cov(drawn.mT) - cov).abs() <= 5 * spread).all())


def test_samples_repeat_with_the_generators_seed(promp):
    first, second, other = (promp.sample(5, torch.Generator().manual_seed(seed)) for seed in (0, 0, 1))
    assert torch.equal(first, second)
    assert not torch.equal(first, other)
