"""Fitting the prior of a ProMP to demonstrations."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ppt_rl.functional.argument_checks import require_whole
from ppt_rl.functional.checks import require_positive
from ppt_rl.functional.promp import Gaussian, unvec, vec
from ppt_rl.functional.shape_checks import require_bool, require_trailing

__all__ = ["fit_em", "fit_ridge"]


def fit_ridge(trajectories: Tensor, basis_matrix: Tensor, ridge: float) -> Gaussian:
    """Fit the weights of each demonstration by ridge regression, and return their mean and covariance.

    Args:
        trajectories: ``(N, T, D)`` demonstrations of equal length.
        basis_matrix: ``(T, K)`` basis at their phases.
        ridge: penalty on squared weights; also added to the diagonal of the covariance.

    Returns:
        Mean ``(K * D,)`` and covariance ``(K * D, K * D)``.

    Raises:
        ValueError: if a shape or number does not fit.
    """
    _check_trajectories(trajectories)
    require_trailing("basis_matrix", basis_matrix, trajectories.shape[1], "K")
    require_positive("ridge", ridge)
    normal = basis_matrix.mT @ basis_matrix + ridge * _identity(basis_matrix.shape[-1], basis_matrix)
    weights = vec(torch.linalg.solve(normal, basis_matrix.mT @ trajectories))
    centred = weights - weights.mean(0)
    cov = centred.mT @ centred / max(1, len(weights) - 1)
    return Gaussian(weights.mean(0), cov + ridge * _identity(cov.shape[-1], cov))


def fit_em(
    trajectories: Tensor,
    mask: Tensor,
    basis_matrix: Tensor,
    ridge: float,
    iterations: int = 100,
    tolerance: float = 1e-8,
) -> tuple[Gaussian, Tensor]:
    r"""Fit ``y_n = (I_D x Phi_n) w_n + noise`` with ``w_n ~ N(mu, Sigma)`` by expectation maximisation.

    Demonstrations may differ in length and have gaps: only samples where the mask is True count.

    Args:
        trajectories: ``(N, T, D)`` padded demonstrations.
        mask: ``(N, T)`` True where a sample exists.
        basis_matrix: ``(N, T, K)`` basis at each demonstration's own phases.
        ridge: penalty of the initial regression; also added to the diagonal of the covariance.
        iterations: largest number of iterations.
        tolerance: the iteration stops when the mean changes by less than this, relative to its norm [-].

    Returns:
        The fitted ``N(mu, Sigma)`` and the variance of the noise, a scalar tensor.

    Raises:
        ValueError: if a shape or number does not fit, or there is no sample.
    """
    _check_trajectories(trajectories)
    require_trailing("mask", mask, *trajectories.shape[:2])
    require_bool("mask", mask)
    if not bool(mask.any()):
        raise ValueError("mask is False everywhere; expected at least one sample. Set it True where a sample exists.")
    require_trailing("basis_matrix", basis_matrix, *trajectories.shape[:2], "K")
    require_positive("ridge", ridge)
    require_whole("iterations", iterations)
    (num, _, dof), num_basis = trajectories.shape, basis_matrix.shape[-1]
    phi, y = basis_matrix * mask.unsqueeze(-1), trajectories * mask.unsqueeze(-1)
    gram, moment = phi.mT @ phi, phi.mT @ y  # (N, K, K), (N, K, D)
    weights = vec(torch.linalg.solve(gram + ridge * _identity(num_basis, y), moment))
    eye, count = _identity(num_basis * dof, y), mask.sum() * dof
    mean, cov = weights.mean(0), torch.cov(weights.mT) + ridge * eye if num > 1 else eye
    noise = (y - phi @ unvec(weights, num_basis)).square().sum() / count + ridge
    data = torch.einsum("de,nij->ndiej", _identity(dof, y), gram).reshape(num, *eye.shape)  # precision times noise
    for _ in range(iterations):
        prior_precision = torch.linalg.inv(cov)
        posterior_cov = torch.linalg.inv(prior_precision + data / noise)
        right = prior_precision @ mean + vec(moment) / noise
        posterior_mean = (posterior_cov @ right.unsqueeze(-1)).squeeze(-1)
        new_mean = posterior_mean.mean(0)
        centred = posterior_mean - new_mean
        cov = (posterior_cov + centred.unsqueeze(-1) * centred.unsqueeze(-2)).mean(0) + ridge * eye
        fit_error = (y - phi @ unvec(posterior_mean, num_basis)).square().sum()
        spread = torch.einsum("nij,nji->", data, posterior_cov)
        noise = ((fit_error + spread) / count).clamp_min(1e-12)
        moved = (new_mean - mean).norm() / mean.norm().clamp_min(math.sqrt(ridge))
        mean = new_mean
        if bool(moved < tolerance):
            break
    return Gaussian(mean, 0.5 * (cov + cov.mT)), noise


def _check_trajectories(trajectories: Tensor) -> None:
    require_trailing("trajectories", trajectories, "D")
    if trajectories.ndim != 3 or not trajectories.numel():
        raise ValueError(
            f"trajectories has shape {tuple(trajectories.shape)}; expected (N, T, D): N demonstrations of T samples."
        )


def _identity(size: int, like: Tensor) -> Tensor:
    return torch.eye(size, dtype=like.dtype, device=like.device)
