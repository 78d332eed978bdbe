"""A probabilistic movement primitive (ProMP) with its prior."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from ppt_rl.functional import promp as law
from ppt_rl.functional.argument_checks import require_instance, require_numbers, require_whole
from ppt_rl.functional.checks import require_finite, require_last_dim, require_positive
from ppt_rl.functional.promp_fit import fit_em, fit_ridge
from ppt_rl.functional.shape_checks import require_bool, require_trailing

__all__ = ["ProMP"]


#: Largest number of degrees of freedom, and of weights in all.
_MOST_DOF, _MOST_WEIGHTS = 100, 5000
#: Largest number of samples at once.
_MOST_SAMPLES = 1_000_000


class ProMP(nn.Module):
    r"""Trajectories ``y(phase) = Phi(phase) W`` with a Gaussian prior over ``vec(W)``.

    Centres, widths and prior are part of ``state_dict``. The prior is a standard normal until it is fitted or loaded.

    Args:
        num_basis: number of basis functions K, 2 to 1000.
        num_dof: number of task-space degrees of freedom D, 1 to 100.
        duration: time from phase 0 to phase 1 [s].
        overlap: width of a basis function as a multiple of the distance between centres [-].
        centres: ``(K,)`` centres in phase; None spreads them evenly over [0, 1].
        widths: ``(K,)`` widths in phase; None derives them from ``overlap``.

    Raises:
        ValueError: if a number is out of range or a shape does not fit.

    Source:
        Paper, eqs. (11) to (16).

    Examples:
        >>> promp = ProMP(num_basis=5, num_dof=2, duration=2.0)
        >>> position, velocity, acceleration = promp.decode(torch.zeros(3, 5, 2), torch.linspace(0, 1, 10))
        >>> position.shape
        torch.Size([3, 10, 2])
    """

    centres: Tensor
    widths: Tensor
    weights_mean: Tensor
    weights_cov: Tensor

    def __init__(
        self,
        num_basis: int,
        num_dof: int,
        duration: float,
        *,
        overlap: float = 0.7,
        centres: Tensor | None = None,
        widths: Tensor | None = None,
    ) -> None:
        super().__init__()
        even_centres, even_widths = law.spread_centres(num_basis, overlap)
        self.num_basis, self.num_dof = int(num_basis), require_whole("num_dof", num_dof, 1, _MOST_DOF)
        centres = even_centres if centres is None else require_numbers("centres", centres, (self.num_basis,))
        widths = even_widths if widths is None else require_numbers("widths", widths, (self.num_basis,))
        if not bool((widths > 0).all()):
            raise ValueError(f"widths are {widths.tolist()}; expected positive numbers.")
        self.duration = require_positive("duration", duration, "s")
        dtype = torch.get_default_dtype()
        size = self.num_basis * self.num_dof
        if size > _MOST_WEIGHTS:
            raise ValueError(
                f"num_basis is {num_basis} and num_dof {num_dof}; expected at most {_MOST_WEIGHTS} weights in all, "
                "since their covariance is a square of that."
            )
        self.register_buffer("centres", centres.to(dtype))
        self.register_buffer("widths", widths.to(dtype))
        self.register_buffer("weights_mean", torch.zeros(self.num_basis, self.num_dof, dtype=dtype))
        self.register_buffer("weights_cov", torch.eye(size, dtype=dtype))

    @property
    def prior(self) -> law.Gaussian:
        """The prior over ``vec(W)``."""
        return law.Gaussian(law.vec(self.weights_mean), self.weights_cov)

    def basis(self, phase: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Basis functions and their first two derivatives with respect to phase.

        Args:
            phase: ``(*B,)`` phase [-].

        Returns:
            Three tensors ``(*B, K)``: value, first and second derivative.

        Raises:
            ValueError: if the phase is no tensor.
        """
        require_instance("phase", phase, Tensor)
        return law.basis(phase, self.centres.to(phase.dtype), self.widths.to(phase.dtype))

    def decode(self, weights: Tensor, phase: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Position, velocity and acceleration at given phases; the derivatives are analytic.

        Args:
            weights: ``(*B, K, D)`` weights.
            phase: ``(T,)`` or ``(*B, T)`` phases [-].

        Returns:
            Three tensors ``(*B, T, D)`` in the unit of y, per second, and per second squared.

        Raises:
            ValueError: if the weights are not ``(*B, K, D)``.
        """
        require_trailing("weights", weights, self.num_basis, self.num_dof)
        value, first, second = self.basis(phase)
        rate = 1.0 / self.duration  # [1/s]
        return law.decode(value, weights), law.decode(first, weights) * rate, law.decode(second, weights) * rate**2

    def sample(self, num_samples: int, generator: torch.Generator | None = None) -> Tensor:
        """Draw weights from the prior.

        Args:
            num_samples: number of samples.
            generator: source of randomness; None takes torch's global one.

        Returns:
            ``(num_samples, K, D)`` weights.

        Raises:
            ValueError: if the number is not whole or below 1.
        """
        num_samples = require_whole("num_samples", num_samples, 1, _MOST_SAMPLES)
        cov = self.weights_cov.double()
        eye = torch.eye(len(cov), dtype=cov.dtype, device=cov.device)
        factor = torch.linalg.cholesky(cov + 1e-12 * cov.diagonal().amax() * eye).to(self.weights_mean.dtype)
        noise = torch.randn(num_samples, len(cov), dtype=factor.dtype, device=factor.device, generator=generator)
        return law.unvec(law.vec(self.weights_mean) + noise @ factor.mT, self.num_basis)

    def fit(self, demonstrations: Tensor | Sequence[Tensor], *, ridge: float = 1e-6) -> ProMP:
        """Fit the prior to demonstrations, in place.

        Demonstrations of equal length are fitted by ridge regression, others by expectation maximisation. The phase
        runs from 0 at the first sample of a demonstration to 1 at its last.

        Args:
            demonstrations: ``(N, T, D)``, or a sequence of N tensors ``(T_n, D)``.
            ridge: penalty of the regression; also added to the diagonal of the covariance [unit of y squared].

        Returns:
            The ProMP itself.

        Raises:
            ValueError: if a shape does not fit, there are fewer than two demonstrations, or a number is not finite.
        """
        require_instance("demonstrations", demonstrations, Tensor, Sequence)
        if isinstance(demonstrations, Tensor):
            demonstrations = list(demonstrations)
        if len(demonstrations) < 2:
            raise ValueError(
                f"got {len(demonstrations)} demonstrations; expected at least 2, to estimate a covariance."
            )
        for demonstration in demonstrations:
            require_last_dim("demonstration", demonstration, self.num_dof)
            require_finite("demonstration", demonstration)
            if demonstration.ndim != 2 or len(demonstration) < 2:
                raise ValueError(f"demonstration has shape {tuple(demonstration.shape)}; expected (T >= 2, D).")
        series = [d.to(self.centres.device, torch.float64) for d in demonstrations]
        phases = [torch.linspace(0.0, 1.0, len(d), dtype=torch.float64, device=d.device) for d in series]
        if len({len(d) for d in series}) == 1:
            prior = fit_ridge(torch.stack(series), self.basis(phases[0])[0], ridge)
        else:
            pad = torch.nn.utils.rnn.pad_sequence
            mask = pad([torch.ones_like(p, dtype=torch.bool) for p in phases], batch_first=True)
            basis = self.basis(pad(phases, batch_first=True))[0]
            prior, _ = fit_em(pad(series, batch_first=True), mask, basis, ridge)
        self.weights_mean.copy_(law.unvec(prior.mean, self.num_basis))
        self.weights_cov.copy_(prior.cov)
        return self

    def posterior(
        self,
        via_phase: Tensor,
        via_position: Tensor,
        via_cov: Tensor,
        via_mask: Tensor | None = None,
        via_velocity: Tensor | None = None,
        via_velocity_cov: Tensor | None = None,
        via_velocity_mask: Tensor | None = None,
        prior: law.Gaussian | None = None,
    ) -> law.Gaussian:
        """Condition the weights on all via-points at once; masked via-points have no effect.

        Args:
            via_phase: ``(*B, M)`` phases [-].
            via_position: ``(*B, M, D)`` positions.
            via_cov: ``(*B, M, D, D)`` covariance of each position.
            via_mask: ``(*B, M)`` True where a via-point counts; None counts all.
            via_velocity: ``(*B, M, D)`` velocities at the same phases [unit/s]; None conditions on positions only.
            via_velocity_cov: ``(*B, M, D, D)`` covariance of each velocity; needed with ``via_velocity``.
            via_velocity_mask: ``(*B, M)`` True where a velocity counts; None takes ``via_mask``.
            prior: what to condition; None takes the ProMP's own prior.

        Returns:
            Mean ``(*B, K * D)`` and covariance ``(*B, K * D, K * D)`` of ``vec(W)``.

        Raises:
            ValueError: if M = 0, a shape does not fit, or an entry that counts is not finite.
        """
        self._check_via(via_phase, via_position, via_cov)
        mask = torch.ones_like(via_phase, dtype=torch.bool) if via_mask is None else via_mask
        self._check_mask("via_mask", mask, via_phase)
        value, first, _ = self.basis(via_phase.double())
        rows, values, covs, masks = [value], [via_position], [via_cov], [mask]
        if via_velocity is not None:
            if via_velocity_cov is None:
                raise ValueError("via_velocity came without via_velocity_cov; pass its covariance (*B, M, D, D) too.")
            self._check_via(via_phase, via_velocity, via_velocity_cov, of="velocity")
            if via_velocity_mask is not None:
                self._check_mask("via_velocity_mask", via_velocity_mask, via_phase)
            rows.append(first / self.duration)
            values.append(via_velocity)
            covs.append(via_velocity_cov)
            masks.append(mask if via_velocity_mask is None else via_velocity_mask)
        used = torch.cat(masks, -1)
        position = torch.cat(values, -2)
        cov = torch.cat(covs, -3)
        self._check_finite(used, torch.cat([via_phase] * len(masks), -1), position, cov)
        observation = law.observation_matrix(torch.cat(rows, -2), self.num_dof)
        row_mask = used.repeat_interleave(self.num_dof, -1)
        prior = self._prior_like(prior, row_mask)
        return law.condition(prior, observation, position.flatten(-2), law.block_diagonal(cov), row_mask)

    def _prior_like(self, prior: law.Gaussian | None, row_mask: Tensor) -> law.Gaussian:
        mean, cov = self.prior if prior is None else prior
        batch = torch.broadcast_shapes(row_mask.shape[:-1], mean.shape[:-1])
        return law.Gaussian(mean.expand(*batch, mean.shape[-1]), cov.expand(*batch, *cov.shape[-2:]))

    @staticmethod
    def _check_mask(name: str, mask: Tensor, phase: Tensor) -> None:
        require_bool(name, mask)
        require_last_dim(name, mask, phase.shape[-1])

    def _check_via(self, phase: Tensor, position: Tensor, cov: Tensor, of: str = "position") -> None:
        cov_name = "via_cov" if of == "position" else f"via_{of}_cov"
        for name, value in (("via_phase", phase), (f"via_{of}", position), (cov_name, cov)):
            require_instance(name, value, Tensor)
        count = phase.shape[-1] if phase.ndim else 0
        if count == 0:
            raise ValueError(
                "via-points are empty (M = 0); expected at least one slot. To condition on none, pass a via_mask that "
                "is False everywhere: the posterior is then the prior."
            )
        dof = self.num_dof
        if position.shape[-2:] != (count, dof) or cov.shape[-3:] != (count, dof, dof):
            raise ValueError(
                f"via_phase {tuple(phase.shape)}, via_{of} {tuple(position.shape)}, {cov_name} {tuple(cov.shape)}; "
                f"expected (*B, {count}), (*B, {count}, {dof}) and (*B, {count}, {dof}, {dof})."
            )

    @staticmethod
    def _check_finite(used: Tensor, phase: Tensor, position: Tensor, cov: Tensor) -> None:
        require_finite("via-point phases", torch.where(used, phase, 0.0))
        require_finite("via-points", torch.where(used.unsqueeze(-1), position, 0.0))
        require_finite("via-point covariance", torch.where(used[..., None, None], cov, 0.0))

    def extra_repr(self) -> str:
        """Sizes and duration, for ``print``."""
        return f"num_basis={self.num_basis}, num_dof={self.num_dof}, duration={self.duration} s"
