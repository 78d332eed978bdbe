"""Cartesian impedance control: a reference becomes a wrench."""

from __future__ import annotations

from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torchrl.data import Composite

from ppt_rl.functional.argument_checks import require_instance
from ppt_rl.functional.checks import require_last_dim
from ppt_rl.functional.impedance import braking_part
from ppt_rl.modules.impedance import CartesianImpedanceController
from ppt_rl.transforms.base import ActionTransform
from ppt_rl.transforms.specs import real, replace_leaf
from ppt_rl.transforms.stability import warn_if_unstable

__all__ = ["ImpedanceTransform"]


class ImpedanceTransform(ActionTransform):
    """Turns a reference, ``(*B, 13)`` pose and twist, into the nominal wrench ``(*B, 6)`` that tracks it.

    It warns once where the controller's gains are unstable at the rate of the environment, because they are too high
    for the inertia of the arm (:func:`~ppt_rl.functional.stability.spectral_radius`).

    Args:
        controller: the law and its gains.
        action_key: the action: reference from outside, wrench towards the environment.
        pose_key: end-effector pose observation.
        twist_key: end-effector twist observation.
        damping_key: where the part of the wrench that brakes (:func:`~ppt_rl.functional.impedance.braking_part`) is
            written beside the action, for an :class:`EnergyTankTransform` that reads it; None writes none.

    Raises:
        ValueError: if the reference has another size than 13.
        KeyError: if an observation is missing.

    Source:
        Paper, section "Cartesian Impedance Control".
    """

    def __init__(
        self,
        controller: CartesianImpedanceController,
        action_key: NestedKey = "action",
        pose_key: NestedKey = "pose",
        twist_key: NestedKey = "twist",
        damping_key: NestedKey | None = None,
    ) -> None:
        super().__init__(action_key)
        require_instance("controller", controller, CartesianImpedanceController)
        self.controller = controller
        self.pose_key = pose_key
        self.twist_key = twist_key
        self.damping_key = damping_key

    @property
    def _readings(self) -> tuple[NestedKey, ...]:
        return self.pose_key, self.twist_key

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        (reference,) = self._require(tensordict, self.action_key)
        pose, twist = self._recall(tensordict, self.pose_key, self.twist_key)
        require_last_dim("reference (pose and twist)", reference, 13)
        if self.damping_key is not None:
            damping = self.controller.damping.to(twist)
            tensordict.set(self.damping_key, braking_part(twist, reference[..., 7:], damping.expand_as(twist)))
        wrench = self.controller(pose, twist, reference[..., :7], reference[..., 7:])
        return tensordict.set(self.action_key, wrench)

    def _check_place(self) -> None:
        warn_if_unstable(self.controller, self.parent)

    def transform_action_spec(self, action_spec: Composite) -> Composite:
        """Outside, the action is a reference: 7 numbers of pose and 6 of twist."""
        like = action_spec[self.action_key]
        spec = real(like, *like.shape[:-1], 13)
        return replace_leaf(action_spec, self.action_key, spec, type(self).__name__)
