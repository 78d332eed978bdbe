"""Probabilistic movement primitives (ProMPs): basis, decoding, Gaussian conditioning."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ppt_rl.functional.argument_checks import require_instance, require_whole
from ppt_rl.functional.checks import require_last_dim, require_positive
from ppt_rl.functional.shape_checks import require_bool, require_same_batch, require_trailing

__all__ = [
    "Gaussian",
    "basis",
    "block_diagonal",
    "condition",
    "decode",
    "observation_matrix",
    "spread_centres",
    "unvec",
    "vec",
]


#: Largest number of basis functions: the covariance of a prior is a square of it.
_MOST = 1000


class Gaussian(NamedTuple):
    """A normal distribution over the stacked weights ``vec(W)``.

    Attributes:
        mean: ``(*B, K * D)`` mean.
        cov: ``(*B, K * D, K * D)`` covariance.
    """

    mean: Tensor
    cov: Tensor


def spread_centres(num_basis: int, overlap: float = 0.7) -> tuple[Tensor, Tensor]:
    """Centres spread evenly over the phase interval [0, 1], and one width for all.

    Args:
        num_basis: number of basis functions K, 2 to 1000.
        overlap: width as a multiple of the distance between centres [-].

    Returns:
        ``(K,)`` centres and ``(K,)`` widths in phase [-].

    Raises:
        ValueError: if a number is out of range.
    """
    num_basis, overlap = require_whole("num_basis", num_basis, 2, _MOST), require_positive("overlap", overlap)
    centres = torch.linspace(0.0, 1.0, num_basis, dtype=torch.float64)
    return centres, torch.full_like(centres, overlap / (num_basis - 1))


def basis(phase: Tensor, centres: Tensor, widths: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    r"""Normalised radial basis functions and their first two derivatives with respect to phase.

    .. math:: \Phi_k = \frac{g_k}{\sum_j g_j},\quad g_k = \exp\Big(-\frac{(\phi - c_k)^2}{2\sigma_k^2}\Big)

    With ``a_k = d log g_k / d phase`` and ``<x> = sum_k Phi_k x_k``:
    ``Phi' = Phi (a - <a>)`` and ``Phi'' = Phi ((a - <a>)^2 + a' - <a'> - <a^2> + <a>^2)``.

    Args:
        phase: ``(*B,)`` phase [-].
        centres: ``(K,)`` centres c [-].
        widths: ``(K,)`` widths sigma [-].

    Returns:
        Three tensors ``(*B, K)``: value, first and second derivative.

    Raises:
        ValueError: if a shape does not fit.

    Source:
        Paper, eq. (11), normalised so that equal weights give a constant trajectory.
    """
    require_instance("phase", phase, Tensor)
    require_trailing("centres", centres, "K")
    require_last_dim("widths", widths, centres.shape[-1])
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
        ``(*B, K * D)`` stacked weights.

    Raises:
        ValueError: if there are fewer than two dimensions.
    """
    require_trailing("weights", weights, "K", "D")
    return weights.mT.flatten(-2)


def unvec(vector: Tensor, num_basis: int) -> Tensor:
    """Inverse of :func:`vec`: ``(*B, K * D) -> (*B, K, D)``.

    Args:
        vector: ``(*B, K * D)`` stacked weights.
        num_basis: number of basis functions K.

    Returns:
        ``(*B, K, D)`` weights.

    Raises:
        ValueError: if the last dimension is no multiple of ``num_basis``.
    """
    require_trailing("vector", vector, "N")
    if vector.shape[-1] % require_whole("num_basis", num_basis):
        raise ValueError(
            f"vector has shape {tuple(vector.shape)}; expected (*batch, K * D), a multiple of {num_basis} basis "
            "functions."
        )
    return vector.unflatten(-1, (-1, num_basis)).mT


def decode(basis_matrix: Tensor, weights: Tensor) -> Tensor:
    """Trajectory ``y = Phi W``.

    Args:
        basis_matrix: ``(*B, T, K)`` basis, or a derivative of it.
        weights: ``(*B, K, D)`` weights.

    Returns:
        ``(*B, T, D)`` trajectory, or its derivative.

    Raises:
        ValueError: if the numbers of basis functions differ.

    Source:
        Paper, eq. (11).
    """
    require_trailing("basis_matrix", basis_matrix, "T", "K")
    require_trailing("weights", weights, "K", "D")
    if basis_matrix.shape[-1] != weights.shape[-2]:
        raise ValueError(
            f"the shapes are basis_matrix {tuple(basis_matrix.shape)}, weights {tuple(weights.shape)}; expected "
            "(*batch, T, K) and (*batch, K, D) with the same number of basis functions K."
        )
    return basis_matrix @ weights


def observation_matrix(basis_rows: Tensor, num_dof: int) -> Tensor:
    """Matrix H that maps weights to observed values: ``H vec(W)`` is ``Phi W``, ``(M, D)``, flattened row by row.

    Args:
        basis_rows: ``(*B, M, K)`` basis Phi at the observed phases.
        num_dof: number of degrees of freedom D.

    Returns:
        ``(*B, M * D, K * D)`` matrix.

    Raises:
        ValueError: if a shape or number does not fit.

    Source:
        Paper, section "Trajectory Posterior via Via-Point Conditioning".
    """
    require_trailing("basis_rows", basis_rows, "M", "K")
    require_whole("num_dof", num_dof)
    eye = torch.eye(num_dof, dtype=basis_rows.dtype, device=basis_rows.device)
    blocks = torch.einsum("...mk,de->...mdek", basis_rows, eye)
    return blocks.flatten(-4, -3).flatten(-2, -1)


def condition(prior: Gaussian, observation: Tensor, value: Tensor, cov: Tensor, mask: Tensor) -> Gaussian:
    r"""Posterior of a Gaussian given all linear observations at once; masked observations have no effect.

    .. math::
        S &= H \Sigma H^\top + \Sigma_D, \quad G = \Sigma H^\top S^{-1} \\
        \mu' &= \mu + G (y - H\mu), \quad
        \Sigma' = (I - G H)\, \Sigma\, (I - G H)^\top + G \Sigma_D G^\top

    The paper gives the algebraically equal information form. The gain form used here also accepts exact observations
    (``Sigma_D = 0``). It is solved by Cholesky factorisation in float64, whatever the precision of the input.

    Args:
        prior: mean ``(*B, N)`` and covariance ``(*B, N, N)``.
        observation: ``(*B, R, N)`` observation matrix H.
        value: ``(*B, R)`` observed values y.
        cov: ``(*B, R, R)`` observation covariance Sigma_D.
        mask: ``(*B, R)`` True where an observation counts.

    Returns:
        The posterior, in the precision of the prior.

    Raises:
        ValueError: if a shape does not fit, or a covariance is not positive semi-definite.

    Source:
        Paper, eqs. (15) and (16).
    """
    _check_condition(prior, observation, value, cov, mask)
    dtype = prior.mean.dtype
    mean, sigma = prior.mean.double(), prior.cov.double()
    # Masked entries may be NaN, so they are replaced by zero: NaN times zero would still be NaN.
    h = torch.where(mask.unsqueeze(-1), observation.double(), 0.0)
    noise = torch.where(mask.unsqueeze(-1) & mask.unsqueeze(-2), cov.double(), 0.0)
    residual = torch.where(mask, value.double(), 0.0) - (h @ mean.unsqueeze(-1)).squeeze(-1)
    cross = h @ sigma  # (*B, R, N)
    innovation = cross @ h.mT + noise
    scale = innovation.diagonal(dim1=-2, dim2=-1).amax(-1, keepdim=True).clamp_min(1e-12)
    # A masked row becomes an independent observation of zero with unit variance; the others get a small jitter.
    pad = torch.where(mask, 1e-12 * scale, torch.ones_like(scale))
    try:
        factor = torch.linalg.cholesky(innovation + torch.diag_embed(pad))
    except torch.linalg.LinAlgError as error:
        raise ValueError(
            "cov, the covariance of the observations, or that of the prior is not positive semi-definite; expected "
            "symmetric matrices without negative eigenvalues."
        ) from error
    gain = torch.cholesky_solve(cross, factor).mT  # (*B, N, R)
    left = torch.eye(mean.shape[-1], dtype=torch.float64, device=mean.device) - gain @ h
    posterior_cov = left @ sigma @ left.mT + gain @ noise @ gain.mT
    posterior_mean = mean + (gain @ residual.unsqueeze(-1)).squeeze(-1)
    return Gaussian(posterior_mean.to(dtype), posterior_cov.to(dtype))


def _check_condition(prior: Gaussian, observation: Tensor, value: Tensor, cov: Tensor, mask: Tensor) -> None:
    """Raise if the parts of a conditioning do not fit together."""
    require_trailing("prior.mean", prior.mean, "N")
    size = prior.mean.shape[-1]
    require_trailing("prior.cov", prior.cov, size, size)
    require_trailing("observation", observation, "R", size)
    rows = observation.shape[-2]
    require_last_dim("value", value, rows)
    require_trailing("cov", cov, rows, rows)
    require_last_dim("mask", mask, rows)
    require_bool("mask", mask)
    require_same_batch(prior=prior.mean, observation=observation[..., 0], value=value, cov=cov[..., 0], mask=mask)


def block_diagonal(blocks: Tensor) -> Tensor:
    """One matrix with the given blocks on its diagonal and zeros elsewhere.

    Args:
        blocks: ``(*B, M, D, D)`` blocks.

    Returns:
        ``(*B, M * D, M * D)`` matrix.

    Raises:
        ValueError: if the blocks are not square.
    """
    require_trailing("blocks", blocks, "M", "D", "D")
    if blocks.shape[-1] != blocks.shape[-2]:
        raise ValueError(f"blocks has shape {tuple(blocks.shape)}; expected (*batch, M, D, D), square blocks.")
    count, dof = blocks.shape[-3], blocks.shape[-1]
    eye = torch.eye(count, dtype=blocks.dtype, device=blocks.device)
    return torch.einsum("...mij,mn->...minj", blocks, eye).reshape(*blocks.shape[:-3], count * dof, count * dof)
