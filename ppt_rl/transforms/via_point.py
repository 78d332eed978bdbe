"""Via-points: the posterior of a movement primitive as an observation."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import TensorSpec

from ppt_rl.functional.argument_checks import require_instance
from ppt_rl.functional.checks import require_last_dim
from ppt_rl.functional.heading import to_heading
from ppt_rl.functional.promp import unvec
from ppt_rl.modules.promp import ProMP
from ppt_rl.transforms.base import Entries
from ppt_rl.transforms.observer import ObserverTransform
from ppt_rl.transforms.specs import real

__all__ = ["ViaPointTransform"]

_POSITION = ("via_phase", "via_position", "via_cov", "via_mask")
_VELOCITY = ("via_velocity", "via_velocity_cov", "via_velocity_mask")


class ViaPointTransform(ObserverTransform):
    r"""Conditions a ProMP's prior on via-points and writes the posterior, to which the policy's residual is added.

    .. math::
        \Sigma_{w|D} = (\Sigma_w^{-1} + H^\top \Sigma_D^{-1} H)^{-1}, \quad
        \mu_{w|D} = \Sigma_{w|D} (\Sigma_w^{-1} \mu_w + H^\top \Sigma_D^{-1} y_D)

    It reads ``via_phase`` ``(*B, M)``, ``via_position`` ``(*B, M, D)``, ``via_cov`` ``(*B, M, D, D)`` and, if present,
    ``via_mask`` ``(*B, M)`` and ``via_velocity``, ``via_velocity_cov`` and ``via_velocity_mask`` of the same shapes. It
    writes ``weights_mean`` ``(*B, K, D)`` and, on request, ``weights_cov`` ``(*B, K * D, K * D)``. It has no state and
    works on stored data too.

    Args:
        promp: the movement primitive and its prior.
        write_cov: whether to write the covariance too.
        prefix: nest of the via-points; empty for the root.
        frame: keys of pose and heading. With them, via-points in world coordinates are expressed in heading axes from
            the end effector, as a :class:`RecedingProMPTransform` needs them. None takes them as they are.

    Raises:
        KeyError: if a via-point entry is missing.
        ValueError: if shapes do not fit.

    Source:
        Paper, eqs. (15) and (16).
    """

    def __init__(
        self,
        promp: ProMP,
        *,
        write_cov: bool = False,
        prefix: tuple[str, ...] = (),
        frame: tuple[NestedKey, NestedKey] | None = None,
    ) -> None:
        require_instance("promp", promp, ProMP)
        if isinstance(prefix, str) or not all(isinstance(part, str) for part in prefix):
            raise ValueError(f"prefix is {prefix!r}; expected a tuple of names, such as ('agent',), or an empty one.")
        if frame is not None and (isinstance(frame, str) or len(frame) != 2):
            raise ValueError(f"frame is {frame!r}; expected two keys, of pose and heading, or None.")
        if frame is not None and promp.num_dof != 3:
            raise ValueError(
                f"frame is {frame!r}, but the ProMP has {promp.num_dof} degrees of freedom; expected 3, which are "
                "expressed in heading axes. Leave frame out."
            )

        def keys(names: tuple[str, ...]) -> list[NestedKey]:
            return [(*prefix, name) if prefix else name for name in names]

        self._position_keys, self._velocity_keys = keys(_POSITION), keys(_VELOCITY)
        self._mean_key, self._cov_key = keys(("weights_mean", "weights_cov"))
        out = [self._mean_key, self._cov_key] if write_cov else [self._mean_key]
        super().__init__(in_keys=[*self._position_keys[:3], *(frame or ())], out_keys=out)
        self.promp = promp
        self.write_cov = write_cov
        self.frame = frame

    def _outputs(self, tensordict: TensorDictBase, state: Entries, *readings: Tensor) -> Entries:
        phase, position, cov = readings[:3]
        mask = tensordict.get(self._position_keys[3], None)
        velocity = [tensordict.get(key, None) for key in self._velocity_keys]
        if self.frame is not None:
            require_last_dim("pose", readings[3], 7)
            pose, heading = readings[3], readings[4].unsqueeze(-2)
            position, cov = _in_frame(position - pose[..., None, :3], cov, heading)
            if velocity[0] is not None and velocity[1] is not None:
                velocity[:2] = _in_frame(velocity[0], velocity[1], heading)
        posterior = self.promp.posterior(phase, position, cov, mask, *velocity)
        outputs = {self._mean_key: unvec(posterior.mean, self.promp.num_basis).to(position.dtype)}
        if self.write_cov:
            outputs[self._cov_key] = posterior.cov.to(position.dtype)
        return outputs

    def _output_specs(self, batch: torch.Size, like: TensorSpec) -> dict[NestedKey, TensorSpec]:
        basis, size = self.promp.num_basis, self.promp.num_basis * self.promp.num_dof
        shapes = {self._mean_key: (basis, self.promp.num_dof), self._cov_key: (size, size)}
        return {key: real(like, *like.shape[:-1], *shapes[key]) for key in self.out_keys}


def _in_frame(vector: Tensor, cov: Tensor, heading: Tensor) -> tuple[Tensor, Tensor]:
    """Vectors ``(*B, M, 3)`` and their covariances in heading axes."""
    once = to_heading(cov, heading.unsqueeze(-2))  # the rows of a symmetric matrix, then its columns
    return to_heading(vector, heading), to_heading(once.mT, heading.unsqueeze(-2))
