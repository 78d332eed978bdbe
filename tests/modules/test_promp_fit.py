import math

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from ppt_rl.modules import ProMP
from tests.modules.conftest import DURATION, D, K
from tests.sampling import normal

F64 = torch.float64


def fitted_to_samples(promp: ProMP, lengths: list[int], noise: float) -> ProMP:
    """A ProMP fitted to noisy trajectories drawn from the prior of another one."""
    generator = torch.Generator().manual_seed(0)
    series: list[Tensor] = []
    for length in sorted(set(lengths)):
        weights = promp.sample(lengths.count(length), generator)
        position, _, _ = promp.decode(weights, torch.linspace(0, 1, length, dtype=F64))
        series.extend(position + noise * torch.randn(position.shape, generator=generator, dtype=F64))
    return ProMP(K, D, DURATION).double().fit(series, ridge=1e-9)


@pytest.mark.parametrize("lengths", [[60] * 500, [40, 50, 55, 60, 70] * 100], ids=["equal", "differing"])
def test_fitting_recovers_the_prior_that_the_demonstrations_were_drawn_from(promp, lengths):
    fitted, (mean, cov) = fitted_to_samples(promp, lengths, noise=0.005).prior, promp.prior
    # Five standard errors of the moments of 500 normal samples; noise of 0.005 over 40 samples adds far less.
    variance = cov.diagonal()
    assert bool(((fitted.mean - mean).abs() <= 5 * (variance / 500).sqrt()).all())
    spread = ((variance[:, None] * variance + cov.square()) / 500).sqrt()
    assert bool(((fitted.cov - cov).abs() <= 5 * spread).all())


def test_a_stacked_tensor_and_a_list_of_demonstrations_give_the_same_fit():
    data = normal(10, 30, D)
    stacked, listed = ProMP(K, D, DURATION).fit(data), ProMP(K, D, DURATION).fit(list(data))
    assert_close(stacked.state_dict(), listed.state_dict(), rtol=0.0, atol=0.0)


def test_the_fitted_covariance_can_be_sampled_from_even_for_equal_demonstrations():
    promp = ProMP(K, D, DURATION).fit(normal(1, 30, D).repeat(3, 1, 1))
    assert bool(torch.isfinite(promp.sample(4)).all())


def test_the_state_dict_contains_basis_and_prior(promp):
    target = ProMP(K, D, DURATION, overlap=1.3).double()
    target.load_state_dict(promp.state_dict())
    phase = torch.rand(5, dtype=F64)
    assert_close(target.prior, promp.prior, rtol=0.0, atol=0.0)
    assert_close(target.basis(phase), promp.basis(phase), rtol=0.0, atol=0.0)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ([torch.zeros(9, D)], "1 demonstrations; expected at least 2"),
        ([torch.zeros(9, D), torch.zeros(9, D + 1)], "demonstration has shape"),
        ([torch.zeros(9, D), torch.zeros(1, D)], r"expected \(T >= 2, D\)"),
        ([torch.zeros(9, D), torch.zeros(D)], r"expected \(T >= 2, D\)"),
        ([torch.zeros(9, D), torch.full((9, D), math.nan)], "demonstration holds 27 NaN"),
    ],
    ids=["one", "columns", "one sample", "flat", "nan"],
)
def test_demonstrations_that_cannot_be_fitted_are_refused(data, message):
    with pytest.raises(ValueError, match=message):
        ProMP(K, D, DURATION).fit(data)


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"num_basis": 1}, "num_basis is 1"),
        ({"num_dof": 0}, "num_dof is 0"),
        ({"duration": 0.0}, "duration is 0.0"),
        ({"overlap": -1.0}, "overlap is -1.0"),
        ({"centres": torch.zeros(3)}, r"centres is tensor\(.*\); expected six finite numbers"),
        ({"widths": torch.ones(7)}, r"widths is tensor\(.*\); expected six finite numbers"),
    ],
    ids=lambda x: next(iter(x)) if isinstance(x, dict) else "",
)
def test_impossible_constants_are_refused(kwargs, message):
    with pytest.raises(ValueError, match=message):
        ProMP(**{"num_basis": K, "num_dof": D, "duration": DURATION, **kwargs})


def test_weights_of_a_wrong_shape_are_refused(promp):
    with pytest.raises(ValueError, match=r"weights has shape .*; expected \(\*batch, 6, 3\)"):
        promp.decode(torch.zeros(D, K), torch.zeros(3))
