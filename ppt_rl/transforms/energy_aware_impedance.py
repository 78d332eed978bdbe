"""Cartesian impedance control with a budget of energy and a limit on power."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torchrl.data import TensorSpec

from ppt_rl.functional.checks import require_last_dim, require_positive
from ppt_rl.functional.energy_aware_impedance import damping_factor, kinetic_energy, spring_energy, stiffness_factor
from ppt_rl.functional.impedance import orientation_error
from ppt_rl.functional.stability import largest_damping_factor
from ppt_rl.modules.impedance import CartesianImpedanceController
from ppt_rl.transforms.impedance import ImpedanceTransform
from ppt_rl.transforms.specs import real
from ppt_rl.transforms.timed import TimedTransform

__all__ = ["EnergyAwareImpedanceTransform"]

_FACTORS = ("stiffness_factor", "damping_factor")


class EnergyAwareImpedanceTransform(TimedTransform, ImpedanceTransform):
    r"""An :class:`ImpedanceTransform` that softens its spring and strengthens its damper to bound energy and power.

    .. math:: \lambda = s\,\big(K\,[x_d - x;\ e_R] + D\,\nu_d\big) - \beta\,D\,\nu, \qquad s = \mu\,\lambda_E

    with ``lambda_E`` from :func:`~ppt_rl.functional.energy_aware_impedance.stiffness_factor` and ``beta`` and ``mu``
    from :func:`~ppt_rl.functional.energy_aware_impedance.damping_factor`. At every control step, for the pose and twist
    observed and with the controller's apparent inertia,

    * the energy of the scaled spring is at most ``max(0, e_max - T)``, where ``T`` is the kinetic energy. A tool at
      rest is pressed with at most ``sqrt(2 k e_max)`` along an axis of stiffness ``k``, and with ``s D nu_d`` more
      while the reference moves;
    * ``wrench . twist <= p_max``. Braking is not limited.

    Where ``s`` and ``beta`` are 1, the wrench is that of the plain impedance, bit by bit. The damping grows to at most
    :func:`~ppt_rl.functional.stability.largest_damping_factor` times its value, since a larger one would make the arm
    chatter at this rate. An energy tank scales the whole wrench, its damper included, and bounds the work of an
    episode; this law keeps the damper and bounds the energy that is stored at a moment.

    It is a transform of its own and no option of :class:`ImpedanceTransform`, because it needs the control step and
    writes observations, which the plain law does not. It takes the same place in a chain.

    State and observations: ``stiffness_factor`` (``s``) and ``damping_factor`` (``beta``), ``(*B, 1)`` each, of the
    last control step.

    Args:
        controller: the law, its gains and the apparent inertia.
        e_max: budget of kinetic energy and spring together [J].
        p_max: largest power towards the world [W].
        dt: control step [s]; None takes it from the environment, and needs one.
        action_key: the action: reference from outside, wrench towards the environment.
        pose_key: end-effector pose observation.
        twist_key: end-effector twist observation.

    Raises:
        ValueError: if a number is out of range, or the reference has another size than 13.
        KeyError: if an observation is missing.

    Source:
        Raiola et al. 2018, "Development of a safety- and energy-aware impedance controller for collaborative robots",
        IEEE Robotics and Automation Letters 3(2). Theirs has a resting reference; the factor on its twist, the bound on
        the damping and ``mu`` are ours.

    Examples:
        >>> EnergyAwareImpedanceTransform(CartesianImpedanceController(), e_max=0.5).e_max
        0.5
    """

    _at_control_rate = True

    def __init__(
        self,
        controller: CartesianImpedanceController,
        e_max: float = 1.0,
        p_max: float = 2.0,
        *,
        dt: float | None = None,
        action_key: NestedKey = "action",
        pose_key: NestedKey = "pose",
        twist_key: NestedKey = "twist",
    ) -> None:
        super().__init__(controller, action_key, pose_key, twist_key)
        self.e_max = require_positive("e_max", e_max, "J")
        self.p_max = require_positive("p_max", p_max, "W")
        self.dt = dt

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        (reference,) = self._require(tensordict, self.action_key)
        pose, twist = self._recall(tensordict, self.pose_key, self.twist_key)
        require_last_dim("reference (pose and twist)", reference, 13)
        controller = self.controller
        stiffness, damping, inertia = (
            gain.to(reference.dtype) for gain in (controller.stiffness, controller.damping, controller.inertia)
        )
        error = torch.cat(
            [reference[..., :3] - pose[..., :3], orientation_error(pose[..., 3:], reference[..., 3:7])], -1
        )
        softened = stiffness_factor(kinetic_energy(twist, inertia), spring_energy(error, stiffness), self.e_max)
        drive = softened * (stiffness * error + damping * reference[..., 7:])
        most = largest_damping_factor(damping, inertia, self.dt)
        beta, weakened = damping_factor(drive, twist, damping, self.p_max, most)
        factor = softened * weakened
        wrench = controller(
            pose, beta * twist, reference[..., :7], factor * reference[..., 7:], factor * stiffness, damping
        )
        for key, value in zip(_FACTORS, (factor, beta), strict=True):
            self._stash(tensordict, key, value.to(reference.dtype))
        return tensordict.set(self.action_key, wrench.to(reference.dtype))

    def _check_place(self) -> None:
        super(ImpedanceTransform, self)._check_place()  # the rate; what follows judges the unscaled gains
        ImpedanceTransform._check_place(self)

    def _after_step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        for key in _FACTORS:
            self._unstash(tensordict, next_tensordict, key)
        return next_tensordict

    def _after_reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        for key, zero in self._zeros(self._state_specs(self.parent.batch_size, self._like()), tensordict_reset).items():
            self._restart(tensordict, tensordict_reset, key, zero + 1.0)
        return tensordict_reset

    def _state_specs(self, batch: torch.Size, like: TensorSpec) -> dict[NestedKey, TensorSpec]:
        return {key: real(like, *like.shape[:-1], 1) for key in _FACTORS}
