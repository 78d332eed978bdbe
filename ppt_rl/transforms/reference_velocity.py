"""Step-wise control around a reference: the velocity of a movement primitive is added to the policy's own."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite, TensorSpec

from ppt_rl.functional.argument_checks import require_in_range, require_instance, require_numbers
from ppt_rl.functional.checks import require_finite, require_last_dim
from ppt_rl.functional.shape_checks import require_trailing
from ppt_rl.modules.promp import ProMP
from ppt_rl.transforms.base import ActionTransform
from ppt_rl.transforms.specs import real
from ppt_rl.transforms.timed import TimedTransform

__all__ = ["ReferenceVelocityTransform"]


class ReferenceVelocityTransform(TimedTransform, ActionTransform):
    r"""Adds the velocity of a movement primitive to a chunk of velocities ``a`` ``(*B, N, D)`` in [-1, 1].

    .. math:: a_n' = \mathrm{clip}\Big(\mathrm{scale} \cdot a_n +
        \frac{y(\phi_{n+1}) - y(\phi_n)}{v_{max}\,\Delta t},\ -1,\ 1\Big), \qquad
        y(\phi) = \Phi(\phi)^\top W_{ref}

    ``W_ref`` is the observation ``weights_mean``, which :class:`ViaPointTransform` writes, or else the mean of the
    ProMP's prior; the phase grows by ``dt / duration`` a control step, and past 1 the reference stands still. An action
    of zero follows the reference, so a step-wise policy begins with the same knowledge as one that acts on the weights
    of the primitive.

    Append it after the :class:`MacroStepTransform` that executes the chunk and before the :class:`HoldActionTransform`
    that makes it, in a chain with a :class:`CartesianVelocityTransform` of the same ``max_velocity``. State and
    observation: ``phase`` ``(*B, 1)`` [-].

    Args:
        promp: the movement primitive.
        max_velocity: one number, or D of them: the velocity that an action of 1 stands for [m/s, rad/s].
        scale: share of the largest velocity that the policy adds at most [-], in (0, 1].
        dt: control step [s]; None takes it from the environment, and needs one.
        action_key: the action, a chunk outside and towards the environment.
        weights_key: reference weights; where missing, the prior's mean.

    Raises:
        ValueError: if a size does not fit, a number is out of range, or an action is not finite.

    Source:
        Residual policies on a reference; the primitive is that of the paper's eq. (11).

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> promp = ProMP(num_basis=4, num_dof=2, duration=1.0)
        >>> follow = ReferenceVelocityTransform(promp, max_velocity=0.4, dt=0.1)
        >>> follow.inv(TensorDict(action=torch.zeros(1, 5, 2), batch_size=[1]))["action"].abs().max()
        tensor(0.)
    """

    def __init__(
        self,
        promp: ProMP,
        *,
        max_velocity: float | Sequence[float],
        scale: float = 0.5,
        dt: float | None = None,
        action_key: NestedKey = "action",
        weights_key: NestedKey = "weights_mean",
    ) -> None:
        super().__init__(action_key)
        require_instance("promp", promp, ProMP)
        speed = require_numbers("max_velocity", max_velocity, (1, promp.num_dof), low=1e-6, unit="m/s, rad/s")
        self.register_buffer("max_velocity", speed.expand(promp.num_dof).clone())
        self.promp = promp
        self.scale = require_in_range("scale", scale, 1e-6, 1.0)
        self.weights_key = weights_key
        self.dt = dt

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        (action,) = self._require(tensordict, self.action_key)
        require_last_dim("action (velocities)", action, self.promp.num_dof)
        require_finite("action (velocities)", action)
        phase = self._known(tensordict, "phase")
        if phase is None:
            phase = torch.zeros_like(action[..., 0, :1])
        steps = torch.arange(action.shape[-2] + 1, dtype=action.dtype, device=action.device)
        phases = phase + steps * (self.dt / self.promp.duration)  # (*B, N + 1)
        positions = self.promp.decode(self._weights(tensordict, action), phases.clamp_max(1.0))[0]
        velocity = positions.diff(dim=-2) / self.dt
        total = self.scale * action + velocity / self.max_velocity.to(action.dtype)
        self._stash(tensordict, "phases", phases)
        return tensordict.set(self.action_key, total.clamp(-1.0, 1.0))

    def _weights(self, tensordict: TensorDictBase, action: Tensor) -> Tensor:
        weights = tensordict.get(self.weights_key, None)
        if weights is None:
            weights = self.promp.weights_mean.expand(*action.shape[:-2], -1, -1)
        require_trailing(str(self.weights_key), weights, self.promp.num_basis, self.promp.num_dof)
        return weights.to(action.dtype)

    def _check_place(self) -> None:
        super()._check_place()
        shape, batch = tuple(self._like().shape), tuple(self.parent.batch_size)
        if len(shape) != len(batch) + 2:
            raise ValueError(
                f"the action {self.action_key!r} of the environment has shape {shape}; expected a chunk "
                f"{(*batch, 'N', self.promp.num_dof)}. Append it after a MacroStepTransform."
            )

    def _after_step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        phases, count = tensordict["_phases"], next_tensordict.get("control_steps", None)
        reached = phases[..., -1:] if count is None else phases.take_along_dim(count, -1)
        tensordict.set("_phase", reached.clamp_max(1.0))
        self._unstash(tensordict, next_tensordict, "phase")
        return next_tensordict

    def _after_reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        zeros = self._zeros(self._state_specs(self.parent.batch_size, self._like()), tensordict_reset)
        self._restart(tensordict, tensordict_reset, "phase", zeros["phase"])
        return tensordict_reset

    def _state_specs(self, batch: torch.Size, like: TensorSpec) -> dict[NestedKey, TensorSpec]:
        return {"phase": real(like, *batch, 1)}

    def transform_action_spec(self, action_spec: Composite) -> Composite:
        """Outside, the action is a chunk of the same shape and bounds."""
        return action_spec
