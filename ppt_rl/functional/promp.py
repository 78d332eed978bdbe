"""Probabilistic movement primitives: basis, decoding, Gaussian conditioning, fitting."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

__all__ = [
    "Gaussian",
    "basis",
    "condition",
    "decode",
    "fit_em",
    "fit_ridge",
    "observation_matrix",
    "spread_centres",
    "unvec",
    "vec",
]


class Gaussian(NamedTuple):
    """A normal distribution over ``vec(W)``.

    Attributes:
        mean: ``(*B, K * D)``.
        cov: ``(*B, K * D, K * D)``.
    """

    mean: Tensor
    cov: Tensor


def spread_centres(num_basis: int, overlap: float = 0.7) -> tuple[Tensor, Tensor]:
    """Centres spread evenly over [0, 1] and the width that makes neighbours overlap.

    Args:
        num_basis: K, at least 2.
        overlap: width in units of the distance between centres.

    Returns:
        ``(K,)`` centres and ``(K,)`` widths, in phase [-].

    Raises:
        ValueError: if ``num_basis`` is below 2.
    """
    if num_basis < 2:
        raise ValueError(f"num_basis is {num_basis}; expected at least 2 basis functions.")
    centres = torch.linspace(0.0, 1.0, num_basis, dtype=torch.float64)
    return centres, torch.full_like(centres, overlap / (num_basis - 1))


def basis(phase: Tensor, centres: Tensor, widths: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    r"""Normalised radial basis functions and their first two derivatives in phase.

    .. math:: \Phi_k = \frac{g_k}{\sum_j g_j},\quad g_k = \exp\Big(-\frac{(\phi - c_k)^2}{2\sigma_k^2}\Big)

    With ``a_k = d log g_k / d phase`` and ``<x> = sum_k Phi_k x_k``:
    ``Phi' = Phi (a - <a>)`` and ``Phi'' = Phi ((a - <a>)^2 + a' - <a'> - <a^2> + <a>^2)``.

    Args:
        phase: ``(*B,)`` phase [-].
        centres: ``(K,)`` c [-].
        widths: ``(K,)`` sigma [-].

    Returns:
        Three tensors ``(*B, K)``: value, first and second derivative.

    Source:
        Paper, eq. (11), normalised so that constant weights give a constant trajectory.
    """
    offset = phase.unsqueeze(-1) - centres
    inverse_var = widths.reciprocal().square()
    value = torch.softmax(-0.5 * offset.square() * inverse_var, -1)
    slope = -offset * inverse_var
    mean_slope = (value * slope).sum(-1, keepdim=True)
    centred = slope - mean_slope
    first = value * centred
    curvature = centred.square() - inverse_var
    second = value * (curvature - (value * curvature).sum(-1, keepdim=True))
    return value, first, second


def vec(weights: Tensor) -> Tensor:
    """Stack the columns of the weight matrix: ``(*B, K, D) -> (*B, K * D)``.

    Args:
        weights: ``(*B, K, D)``, one column per task-space degree of freedom.

    Returns:
        ``(*B, K * D)``.
    """
    return weights.mT.flatten(-2)


def unvec(vector: Tensor, num_basis: int) -> Tensor:
    """Inverse of :func:`vec`: ``(*B, K * D) -> (*B, K, D)``.

    Args:
        vector: ``(*B, K * D)``.
        num_basis: K.

    Returns:
        ``(*B, K, D)``.
    """
    return vector.unflatten(-1, (-1, num_basis)).mT


def decode(basis_matrix: Tensor, weights: Tensor) -> Tensor:
    """Trajectory ``y = Phi W``.

    Args:
        basis_matrix: ``(*B, T, K)`` basis, or a derivative of it.
        weights: ``(*B, K, D)``.

    Returns:
        ``(*B, T, D)``.

    Source:
        Paper, eq. (11).
    """
    return basis_matrix @ weights


def observation_matrix(basis_rows: Tensor, num_dof: int) -> Tensor:
    """Matrix H with ``H vec(W) = vec of (M, D) observed values`` in row-major order.

    Args:
        basis_rows: ``(*B, M, K)`` basis at the observed phases.
        num_dof: D.

    Returns:
        ``(*B, M * D, K * D)``.

    Source:
        Paper, section "Trajectory Posterior via Via-Point Conditioning".
    """
    eye = torch.eye(num_dof, dtype=basis_rows.dtype, device=basis_rows.device)
    blocks = torch.einsum("...mk,de->...mdek", basis_rows, eye)
    return blocks.flatten(-4, -3).flatten(-2, -1)


def condition(prior: Gaussian, observation: Tensor, value: Tensor, cov: Tensor, mask: Tensor) -> Gaussian:
    r"""Posterior of a Gaussian under linear observations, all at once, masked ones without effect.

    .. math::
        S &= H \Sigma H^\top + \Sigma_D, \quad G = \Sigma H^\top S^{-1} \\
        \mu' &= \mu + G (y - H\mu), \quad
        \Sigma' = (I - G H)\, \Sigma\, (I - G H)^\top + G \Sigma_D G^\top

    Algebraically the information form of the paper; the gain form also takes exact observations (``Sigma_D = 0``).
    Solved in float64 by Cholesky, whatever the input's precision.

    Args:
        prior: mean ``(*B, N)`` and covariance ``(*B, N, N)``.
        observation: ``(*B, R, N)`` H.
        value: ``(*B, R)`` observed values y.
        cov: ``(*B, R, R)`` observation covariance.
        mask: ``(*B, R)`` True where the row counts.

    Returns:
        The posterior, in the prior's precision.

    Source:
        Paper, eqs. (15) and (16).
    """
    dtype = prior.mean.dtype
    mean, sigma = prior.mean.double(), prior.cov.double()
    # Selected, not multiplied by zero: what a masked row holds may be NaN.
    h = torch.where(mask.unsqueeze(-1), observation.double(), 0.0)
    noise = torch.where(mask.unsqueeze(-1) & mask.unsqueeze(-2), cov.double(), 0.0)
    residual = torch.where(mask, value.double(), 0.0) - (h @ mean.unsqueeze(-1)).squeeze(-1)
    cross = h @ sigma  # (*B, R, N)
    innovation = cross @ h.mT + noise
    scale = innovation.diagonal(dim1=-2, dim2=-1).amax(-1, keepdim=True).clamp_min(1e-12)
    # Masked rows become independent unit observations of zero; the rest gets the jitter of a float64 solve.
    pad = torch.where(mask, 1e-12 * scale, torch.ones_like(scale))
    factor = torch.linalg.cholesky(innovation + torch.diag_embed(pad))
    gain = torch.cholesky_solve(cross, factor).mT  # (*B, N, R)
    left = torch.eye(mean.shape[-1], dtype=torch.float64, device=mean.device) - gain @ h
    posterior_cov = left @ sigma @ left.mT + gain @ noise @ gain.mT
    posterior_mean = mean + (gain @ residual.unsqueeze(-1)).squeeze(-1)
    return Gaussian(posterior_mean.to(dtype), posterior_cov.to(dtype))


def fit_ridge(trajectories: Tensor, basis_matrix: Tensor, ridge: float) -> Gaussian:
    """Weights of each demonstration by ridge regression, then their mean and covariance.

    Args:
        trajectories: ``(N, T, D)`` demonstrations of equal length.
        basis_matrix: ``(T, K)`` basis at their phases.
        ridge: penalty on squared weights, and floor of the covariance's diagonal.

    Returns:
        Mean ``(K * D,)`` and covariance ``(K * D, K * D)``.
    """
    num_basis = basis_matrix.shape[-1]
    eye = torch.eye(num_basis, dtype=basis_matrix.dtype, device=basis_matrix.device)
    normal = basis_matrix.mT @ basis_matrix + ridge * eye
    weights = vec(torch.linalg.solve(normal, basis_matrix.mT @ trajectories))
    centred = weights - weights.mean(0)
    cov = centred.mT @ centred / max(1, len(weights) - 1)
    return Gaussian(weights.mean(0), cov + ridge * torch.eye(cov.shape[-1], dtype=cov.dtype, device=cov.device))


def fit_em(
    trajectories: Tensor,
    mask: Tensor,
    basis_matrix: Tensor,
    ridge: float,
    iterations: int = 100,
    tolerance: float = 1e-8,
) -> tuple[Gaussian, Tensor]:
    r"""Maximum likelihood of ``y_n = (I_D x Phi_n) w_n + noise``, ``w_n ~ N(mu, Sigma)``, by expectation maximisation.

    Demonstrations may differ in length and have gaps: only samples under the mask count.

    Args:
        trajectories: ``(N, T, D)`` padded demonstrations.
        mask: ``(N, T)`` True where a sample exists.
        basis_matrix: ``(N, T, K)`` basis at each demonstration's own phases.
        ridge: penalty of the initial regression and floor of the covariance's diagonal.
        iterations: most iterations.
        tolerance: stop when the mean moves less than this, relative to its norm.

    Returns:
        The prior ``N(mu, Sigma)`` and the noise variance, a scalar tensor.
    """
    num, _, dof = trajectories.shape
    num_basis = basis_matrix.shape[-1]
    size = num_basis * dof
    phi = basis_matrix * mask.unsqueeze(-1)
    y = trajectories * mask.unsqueeze(-1)
    eye_k = torch.eye(num_basis, dtype=y.dtype, device=y.device)
    eye = torch.eye(size, dtype=y.dtype, device=y.device)
    gram = phi.mT @ phi  # (N, K, K)
    moment = phi.mT @ y  # (N, K, D)
    weights = vec(torch.linalg.solve(gram + ridge * eye_k, moment))
    mean = weights.mean(0)
    cov = torch.cov(weights.mT) + ridge * eye if num > 1 else eye
    count = mask.sum() * dof
    noise = (y - phi @ unvec(weights, num_basis)).square().sum() / count + ridge
    eye_d = torch.eye(dof, dtype=y.dtype, device=y.device)
    precision_data = torch.einsum("de,nij->ndiej", eye_d, gram).reshape(num, size, size)
    for _ in range(iterations):
        prior_precision = torch.linalg.inv(cov)
        posterior_cov = torch.linalg.inv(prior_precision + precision_data / noise)
        right = prior_precision @ mean + vec(moment) / noise
        posterior_mean = (posterior_cov @ right.unsqueeze(-1)).squeeze(-1)
        new_mean = posterior_mean.mean(0)
        centred = posterior_mean - new_mean
        cov = (posterior_cov + centred.unsqueeze(-1) * centred.unsqueeze(-2)).mean(0) + ridge * eye
        fit_error = (y - phi @ unvec(posterior_mean, num_basis)).square().sum()
        spread = torch.einsum("nij,nji->", precision_data, posterior_cov)
        noise = ((fit_error + spread) / count).clamp_min(1e-12)
        moved = (new_mean - mean).norm() / mean.norm().clamp_min(math.sqrt(ridge))
        mean = new_mean
        if bool(moved < tolerance):
            break
    return Gaussian(mean, 0.5 * (cov + cov.mT)), noise
