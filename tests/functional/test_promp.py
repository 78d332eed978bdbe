import pytest
import torch
from torch.testing import assert_close

from ppt_rl.functional.promp import (
    Gaussian,
    basis,
    block_diagonal,
    condition,
    decode,
    observation_matrix,
    spread_centres,
    unvec,
    vec,
)
from tests.sampling import normal, random_gaussian

F64 = torch.float64
TIGHT = {"rtol": 0.0, "atol": 1e-12}
PHASE = torch.linspace(-0.1, 1.1, 37, dtype=F64)
UNEVEN = (torch.tensor([0.0, 0.1, 0.5, 0.6, 1.0], dtype=F64), torch.tensor([0.1, 0.3, 0.15, 0.2, 0.25], dtype=F64))
each_layout = pytest.mark.parametrize(
    "layout", [spread_centres(2), spread_centres(8), spread_centres(25, 0.4), UNEVEN], ids=["2", "8", "25", "uneven"]
)


@each_layout
def test_basis_sums_to_one_and_its_derivatives_to_zero(layout):
    value, first, second = (part.sum(-1) for part in basis(PHASE, *layout))
    assert_close(value, torch.ones_like(PHASE), **TIGHT)
    assert_close(first, torch.zeros_like(PHASE), **TIGHT)
    assert_close(second, torch.zeros_like(PHASE), rtol=0.0, atol=1e-10)


@each_layout
def test_basis_is_the_normalised_gaussian(layout):
    centres, widths = layout
    bump = torch.exp(-((PHASE.unsqueeze(-1) - centres) ** 2) / (2 * widths**2))
    assert_close(basis(PHASE, *layout)[0], bump / bump.sum(-1, keepdim=True), **TIGHT)


@each_layout
@pytest.mark.parametrize("order", [0, 1])
def test_each_analytic_derivative_is_the_derivative_of_the_one_before(layout, order):
    phase = PHASE.clone().requires_grad_()
    parts = basis(phase, *layout)
    columns = [torch.autograd.grad(column.sum(), phase, retain_graph=True)[0] for column in parts[order].unbind(-1)]
    expected = torch.stack(columns, -1)
    assert_close(parts[order + 1], expected, rtol=1e-10, atol=1e-10)


@each_layout
def test_analytic_derivatives_equal_finite_differences(layout):
    h = 1e-5
    before, at, after = (basis(PHASE + shift, *layout) for shift in (-h, 0.0, h))
    assert_close(at[1], (after[0] - before[0]) / (2 * h), rtol=1e-5, atol=1e-5)
    assert_close(at[2], (after[1] - before[1]) / (2 * h), rtol=1e-5, atol=1e-4)


def test_basis_is_finite_far_outside_the_centres():
    parts = basis(torch.tensor([-50.0, 50.0]), *(x.float() for x in spread_centres(10)))
    assert all(bool(torch.isfinite(part).all()) for part in parts)
    assert_close(parts[0][:, [0, -1]], torch.eye(2))


def test_centres_are_spread_evenly_and_widths_are_overlap_times_their_distance():
    centres, widths = spread_centres(5, overlap=0.8)
    assert_close(centres, torch.tensor([0.0, 0.25, 0.5, 0.75, 1.0], dtype=F64))
    assert_close(widths, torch.full((5,), 0.2, dtype=F64))


def test_a_single_basis_function_is_refused():
    with pytest.raises(ValueError, match="num_basis is 1; expected a whole number from 2 to"):
        spread_centres(1)


def test_vec_stacks_the_columns():
    weights = torch.tensor([[1, 4], [2, 5], [3, 6]])
    assert vec(weights).tolist() == [1, 2, 3, 4, 5, 6]


@pytest.mark.parametrize("batch", [(), (3,), (2, 3)])
def test_unvec_undoes_vec(batch):
    weights = normal(*batch, 4, 3)
    assert torch.equal(unvec(vec(weights), 4), weights)


def test_observation_matrix_maps_the_stacked_columns_to_the_decoded_rows():
    value = basis(torch.rand(2, 6, dtype=F64), *spread_centres(4))[0]
    weights = normal(2, 4, 3)
    rows = (observation_matrix(value, 3) @ vec(weights).unsqueeze(-1)).squeeze(-1)
    assert_close(rows, decode(value, weights).flatten(-2), **TIGHT)


def test_observation_matrix_rows_are_kronecker_products():
    value = basis(torch.tensor([0.3], dtype=F64), *spread_centres(4))[0]
    assert_close(observation_matrix(value, 2), torch.kron(torch.eye(2, dtype=F64), value))


def test_a_block_diagonal_matrix_has_its_blocks_in_order_and_zeros_elsewhere():
    blocks = normal(5, 3, 2, 2)
    expected = torch.stack([torch.block_diag(*row) for row in blocks])
    assert torch.equal(block_diagonal(blocks), expected)


def test_conditioning_equals_the_information_form():
    prior, h, noise = random_gaussian(9), normal(4, 9, seed=5), random_gaussian(4, seed=6).cov
    y = normal(4, seed=7)
    precision = torch.linalg.inv(prior.cov) + h.mT @ torch.linalg.solve(noise, h)
    right = torch.linalg.solve(prior.cov, prior.mean) + h.mT @ torch.linalg.solve(noise, y)
    posterior = condition(prior, h, y, noise, torch.ones(4, dtype=torch.bool))
    assert_close(posterior.mean, torch.linalg.solve(precision, right), rtol=0.0, atol=1e-9)
    assert_close(posterior.cov, torch.linalg.inv(precision), rtol=0.0, atol=1e-9)


def test_exact_observations_are_met():
    prior, h, y = random_gaussian(9), normal(4, 9, seed=5), normal(4, seed=7)
    posterior = condition(prior, h, y, torch.zeros(4, 4, dtype=F64), torch.ones(4, dtype=torch.bool))
    assert_close(h @ posterior.mean, y, rtol=0.0, atol=1e-9)
    assert_close(h @ posterior.cov @ h.mT, torch.zeros(4, 4, dtype=F64), rtol=0.0, atol=1e-9)


def test_observing_in_two_steps_equals_observing_at_once():
    prior, h, y = random_gaussian(9), normal(4, 9, seed=5), normal(4, seed=7)
    noise, both = 0.1 * torch.eye(4, dtype=F64), torch.ones(4, dtype=torch.bool)
    first = condition(prior, h[:2], y[:2], noise[:2, :2], both[:2])
    second = condition(first, h[2:], y[2:], noise[2:, 2:], both[2:])
    assert_close(second, condition(prior, h, y, noise, both), rtol=0.0, atol=1e-9)


def test_the_result_has_the_priors_precision():
    prior = Gaussian(*(part.float() for part in random_gaussian(9)))
    posterior = condition(prior, normal(4, 9), normal(4), torch.eye(4), torch.ones(4, dtype=torch.bool))
    assert posterior.mean.dtype == posterior.cov.dtype == torch.float32


def test_conditioning_is_differentiable_in_values_and_covariance():
    prior, h, mask = random_gaussian(6), normal(3, 6, seed=5), torch.tensor([True, False, True])
    inputs = normal(3).requires_grad_(), random_gaussian(3).cov.requires_grad_()
    assert torch.autograd.gradcheck(lambda y, c: tuple(condition(prior, h, y, 0.5 * (c + c.mT), mask)), inputs)
