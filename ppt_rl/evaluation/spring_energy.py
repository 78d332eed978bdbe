"""Energy in the virtual spring of an impedance controller."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torchrl.data import TensorSpec

from ppt_rl.functional.energy_aware_impedance import spring_energy
from ppt_rl.functional.impedance import orientation_error
from ppt_rl.modules.impedance import CartesianImpedanceController
from ppt_rl.transforms.base import ActionTransform
from ppt_rl.transforms.specs import real

__all__ = ["SPRING_ENERGY", "SpringEnergyTransform"]

#: Key of the energy, and of a factor on the stiffness that an impedance may write.
SPRING_ENERGY, _FACTOR = "spring_energy", "stiffness_factor"


class SpringEnergyTransform(ActionTransform):
    r"""Records the largest energy of the virtual spring in an episode so far, at control rate.

    .. math:: E = \tfrac12\,e^\top K\,e, \qquad e = [x_d - x;\ e_R]

    from the reference that reaches the controller, the measured pose and the controller's stiffness; where an impedance
    that softens its spring writes ``stiffness_factor``, K is multiplied by it. It writes ``spring_energy`` ``(*B, 1)``
    [J] and leaves the reference alone. Append it right after the impedance.

    Args:
        controller: the controller whose spring it is.
        action_key: the reference, ``(*B, 13)`` pose and twist.
        pose_key: end-effector pose observation.
    """

    _at_control_rate = True

    def __init__(
        self, controller: CartesianImpedanceController, action_key: NestedKey = "action", pose_key: NestedKey = "pose"
    ) -> None:
        super().__init__(action_key)
        self.controller = controller
        self.pose_key = pose_key

    @property
    def _readings(self) -> tuple[NestedKey, ...]:
        return (self.pose_key,)

    def _state_specs(self, batch: torch.Size, like: TensorSpec) -> dict[NestedKey, TensorSpec]:
        return {SPRING_ENERGY: real(like, *like.shape[:-1], 1)}

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        (reference,) = self._require(tensordict, self.action_key)
        (pose,) = self._recall(tensordict, self.pose_key)
        linear = reference[..., :3] - pose[..., :3]
        error = torch.cat([linear, orientation_error(pose[..., 3:], reference[..., 3:7])], -1)
        stiffness = self.controller.stiffness.to(error.dtype)
        self._stash(tensordict, SPRING_ENERGY, spring_energy(error, stiffness))
        return tensordict

    def _after_step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        self._unstash(tensordict, next_tensordict, SPRING_ENERGY)
        energy, factor = next_tensordict.get(SPRING_ENERGY), next_tensordict.get(_FACTOR, None)
        energy = energy if factor is None else factor * energy
        (before,) = self._recall(tensordict, SPRING_ENERGY)
        return next_tensordict.set(SPRING_ENERGY, torch.maximum(before, energy))

    def _after_reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        zeros = self._zeros(self._state_specs(self.parent.batch_size, self._like()), tensordict_reset)
        self._restart(tensordict, tensordict_reset, SPRING_ENERGY, zeros[SPRING_ENERGY])
        return tensordict_reset
