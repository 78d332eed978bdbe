"""Decoding a ProMP: a residual in weight space becomes a chunk of references."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite, TensorSpec

from ppt_rl.functional.argument_checks import require_instance, require_numbers, require_whole
from ppt_rl.functional.checks import require_finite, require_last_dim
from ppt_rl.functional.promp import Gaussian, unvec, vec
from ppt_rl.functional.shape_checks import require_trailing
from ppt_rl.modules.joint_space import JointSpace
from ppt_rl.modules.promp import ProMP
from ppt_rl.modules.task_space import TaskSpace
from ppt_rl.transforms.base import ActionTransform
from ppt_rl.transforms.specs import real, replace_leaf
from ppt_rl.transforms.timed import TimedTransform

__all__ = ["ProMPTransform"]

#: The state of the reference at the end of a chunk.
_LEFT = ("phase", "reference_position", "reference_velocity")


class ProMPTransform(TimedTransform, ActionTransform):
    r"""Turns a residual ``dw`` ``(*B, K * D)`` into the references of the next control steps, ``(*B, N, 13)``.

    .. math:: w = w_{ref} + \mathrm{scale} \cdot \Delta w, \qquad y(\phi) = \Phi(\phi)^\top W

    ``w_ref`` is the observation ``weights_mean``, which :class:`ViaPointTransform` writes, or else the mean of the
    ProMP's prior. The new weights are then conditioned on the position and velocity of the reference where the last
    chunk ended (at the start of an episode: on the measured pose at rest), so reference and velocity are continuous.

    State and observations: ``phase`` ``(*B, 1)`` [-], ``reference_position`` and ``reference_velocity`` ``(*B, D)``,
    and the weights that were decoded last, ``weights`` ``(*B, K, D)``.

    Args:
        promp: the movement primitive.
        task_space: meaning of its D coordinates.
        residual_scale: one number, or D of them: how far a residual of 1 moves a weight [unit of each coordinate]. With
            0, a policy leaves a coordinate to the reference.
        replan_steps: control steps from one policy step to the next. None is the paper's "episode-level": one policy
            step for the whole duration; 1 is its "each timestep". Each hand-over bends the reference locally, so steps
            much shorter than the duration divided by K make it lag.
        dt: control step [s]; None takes it from the environment, and needs one.
        action_key: the action: residual outside, references towards the environment.
        pose_key: end-effector pose observation.
        weights_key: reference weights, as :class:`ViaPointTransform` writes them; where missing, the prior's mean.

    Raises:
        ValueError: if sizes do not fit, the duration is no multiple of ``dt``, or an action is not finite.

    Source:
        Paper, eqs. (11) and (13).
    """

    def __init__(
        self,
        promp: ProMP,
        task_space: TaskSpace,
        *,
        residual_scale: float | Sequence[float] = 0.03,
        replan_steps: int | None = None,
        dt: float | None = None,
        action_key: NestedKey = "action",
        pose_key: NestedKey = "pose",
        weights_key: NestedKey = "weights_mean",
    ) -> None:
        super().__init__(action_key)
        require_instance("promp", promp, ProMP)
        require_instance("task_space", task_space, TaskSpace, JointSpace)
        if promp.num_dof != task_space.num_dof:
            raise ValueError(
                f"the ProMP has {promp.num_dof} degrees of freedom and the task space has the coordinates "
                f"{task_space.axes}; expected equal numbers."
            )
        scale = require_numbers("residual_scale", residual_scale, (1, promp.num_dof))
        if not bool((scale >= 0).all() & (scale > 0).any()):
            raise ValueError(
                f"residual_scale is {residual_scale}; expected 1 or {promp.num_dof} numbers of at least 0, not all 0."
            )
        self.promp = promp
        self.task_space = task_space
        self.pose_key = pose_key
        self.weights_key = weights_key
        self.replan_steps = None if replan_steps is None else require_whole("replan_steps", replan_steps)
        self.register_buffer("residual_scale", scale.expand(promp.num_dof).clone())
        self.dt = dt

    @property
    def total_steps(self) -> int:
        """Control steps of the primitive's whole duration."""
        return round(self.promp.duration / self.dt)

    @property
    def num_steps(self) -> int:
        """Control steps of a chunk."""
        return self.total_steps if self.replan_steps is None else self.replan_steps

    def _accept_dt(self, dt: float) -> None:
        duration, replan = self.promp.duration, self.replan_steps
        total = round(duration / dt)
        if total < 1 or abs(total * dt - duration) > 1e-6:
            raise ValueError(
                f"the ProMP's duration is {duration} s; expected a multiple of the control step, dt={dt} s."
            )
        if replan is not None and not 1 <= replan <= total:
            raise ValueError(f"replan_steps is {replan}; expected 1 to {total}, or None.")

    @property
    def _readings(self) -> tuple[NestedKey, ...]:
        return (self.pose_key,)

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        (action,) = self._require(tensordict, self.action_key)
        require_last_dim("action (ProMP residual)", action, self.promp.num_basis * self.promp.num_dof)
        require_finite("action (ProMP residual)", action)
        phase, position, velocity = self._current(tensordict, action)
        weights = self._joined(self._weights(tensordict, action), phase, position, velocity)
        total = self.total_steps
        offsets = torch.arange(self.num_steps + 1, dtype=action.dtype, device=action.device) / total
        phases = (phase + offsets).clamp_max(1.0)  # (*B, N + 1)
        positions, velocities, _ = self.promp.decode(weights, phases)
        # Past the end the reference stands still.
        velocities = velocities * (phase + offsets <= 1.0 + 0.5 / total).unsqueeze(-1)
        positions, velocities = self._placed(tensordict, positions, velocities)
        reference = torch.cat([self.task_space.pose(positions), self.task_space.twist(velocities)], -1)
        tensordict.set(self.action_key, reference[..., :-1, :])
        self._stash(tensordict, "weights", weights)
        # A chunk may be interrupted, so only at its end is it known where the reference has got to.
        self._stash(tensordict, "path", torch.cat([phases.unsqueeze(-1), positions, velocities], -1))
        return tensordict

    def _current(self, tensordict: TensorDictBase, action: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Phase, position and velocity of the reference; without a state, the measured pose at rest at phase zero."""
        phase = self._known(tensordict, "phase")
        if phase is None:
            (pose,) = self._recall(tensordict, self.pose_key)
            position = self.task_space.project(pose).to(action.dtype)
            return torch.zeros_like(action[..., :1]), position, torch.zeros_like(position)
        position, velocity = self._recall(tensordict, "reference_position", "reference_velocity")
        return phase, position, velocity

    def _placed(self, tensordict: TensorDictBase, positions: Tensor, velocities: Tensor) -> tuple[Tensor, Tensor]:
        """Decoded positions and velocities ``(*B, N + 1, D)`` in the coordinates of the task space."""
        return positions, velocities

    def _weights(self, tensordict: TensorDictBase, action: Tensor) -> Tensor:
        reference = tensordict.get(self.weights_key, None)
        if reference is None:
            reference = self.promp.weights_mean
        require_trailing(str(self.weights_key), reference, self.promp.num_basis, self.promp.num_dof)
        reference = reference.to(action.dtype)
        return reference + self.residual_scale.to(action.dtype) * unvec(action, self.promp.num_basis)

    def _joined(self, weights: Tensor, phase: Tensor, position: Tensor, velocity: Tensor) -> Tensor:
        """The nearest weights that pass through position and velocity at ``phase``.

        Distance is Euclidean in the weights: the basis is local, so the change stays near ``phase``. In the metric of
        the prior, a millimetre at the start would turn into another trajectory altogether.
        """
        dof = self.promp.num_dof
        exact = position.new_zeros(*position.shape[:-1], 1, dof, dof)
        mean = vec(weights).double()
        nearest = Gaussian(mean, torch.eye(mean.shape[-1], dtype=mean.dtype, device=mean.device))
        joined = self.promp.posterior(
            phase,
            position.unsqueeze(-2),
            exact,
            via_velocity=velocity.unsqueeze(-2),
            via_velocity_cov=exact,
            prior=nearest,
        )
        return unvec(joined.mean, self.promp.num_basis).to(weights.dtype)

    # -- state --------------------------------------------------------------------------------------------------------

    def _after_step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        self._unstash(tensordict, next_tensordict, "weights")
        path = tensordict.get("_path")  # (*B, N + 1, 1 + 2 D)
        left = path[..., -1, :]
        executed = next_tensordict.get("control_steps", None)
        if executed is not None:
            left = path.take_along_dim(executed.unsqueeze(-1).expand(*executed.shape, path.shape[-1]), -2).squeeze(-2)
        dof = self.promp.num_dof
        for key, value in zip(_LEFT, left.split([1, dof, dof], -1), strict=True):
            tensordict.set(f"_{key}", value)
            self._unstash(tensordict, next_tensordict, key)
        return next_tensordict

    def _after_reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        (pose,) = self._require(tensordict_reset, self.pose_key)
        position = self.task_space.project(pose).to(self._like().dtype)
        zeros = self._zeros(self._state_specs(self.parent.batch_size, self._like()), tensordict_reset)
        self._restart(tensordict, tensordict_reset, "phase", zeros["phase"])
        self._restart(tensordict, tensordict_reset, "reference_position", position)
        self._restart(tensordict, tensordict_reset, "reference_velocity", torch.zeros_like(position))
        self._restart(tensordict, tensordict_reset, "weights", zeros["weights"])
        return tensordict_reset

    def _state_specs(self, batch: torch.Size, like: TensorSpec) -> dict[NestedKey, TensorSpec]:
        dof = self.promp.num_dof
        return {
            "phase": real(like, *batch, 1),
            "reference_position": real(like, *batch, dof),
            "reference_velocity": real(like, *batch, dof),
            "weights": real(like, *batch, self.promp.num_basis, dof),
        }

    def transform_action_spec(self, action_spec: Composite) -> Composite:
        """Outside, the action is a residual of K * D numbers."""
        like = action_spec[self.action_key]
        spec = real(like, *self.parent.batch_size, self.promp.num_basis * self.promp.num_dof)
        return replace_leaf(action_spec, self.action_key, spec, type(self).__name__)
