"""Proportional-derivative control of the joints: a reference becomes an effort."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite

from ppt_rl.functional.checks import require_last_dim
from ppt_rl.functional.joints import joint_difference, joint_effort
from ppt_rl.modules.joint_space import continuous_joints
from ppt_rl.transforms.base import ActionTransform
from ppt_rl.transforms.specs import real, replace_leaf

__all__ = ["PDTrackingTransform"]


class PDTrackingTransform(ActionTransform):
    r"""Turns a reference ``(*B, 2 D)``, position then velocity of D joints, into the effort ``(*B, D)`` that tracks it.

    .. math:: \tau = K\,(q_d - q) + D\,(\dot q_d - \dot q)

    It is for any robot that takes joint efforts and observes its joints, and needs no kinematics. With a
    :class:`~ppt_rl.modules.JointSpace`, a :class:`ProMPTransform` or :class:`CartesianVelocityTransform` makes such
    references. Its effort is not clipped: the environment's limits are.

    Args:
        stiffness: K, one number or D of them [N m/rad], [N/m] for a sliding joint.
        damping: D, one number or D of them [N m s/rad], [N s/m].
        continuous: indices of the joints whose position is only known up to whole turns; their error is taken the
            shorter way round.
        position_key: joint position observation.
        velocity_key: joint velocity observation.
        action_key: the action: reference from outside, effort towards the environment.

    Raises:
        ValueError: if a gain is negative or not finite, or a size does not fit.
        KeyError: if an observation is missing.

    Examples:
        >>> transform = PDTrackingTransform(stiffness=2.0, damping=(0.1, 0.2))
        >>> from tensordict import TensorDict
        >>> joints = {"joint_position": torch.zeros(2), "joint_velocity": torch.ones(2)}
        >>> transform.inv(TensorDict({**joints, "action": torch.tensor([0.5, 1.0, 1.0, 0.0])}))["action"]
        tensor([1.0000, 1.8000])
    """

    stiffness: Tensor
    damping: Tensor

    def __init__(
        self,
        stiffness: float | Sequence[float],
        damping: float | Sequence[float],
        *,
        continuous: Sequence[int] = (),
        position_key: NestedKey = "joint_position",
        velocity_key: NestedKey = "joint_velocity",
        action_key: NestedKey = "action",
    ) -> None:
        super().__init__(action_key)
        self.position_key = position_key
        self.velocity_key = velocity_key
        self.continuous = tuple(continuous)
        self.register_buffer("stiffness", _gain("stiffness", stiffness))
        self.register_buffer("damping", _gain("damping", damping))

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        reference, position, velocity = self._require(tensordict, self.action_key, self.position_key, self.velocity_key)
        count = position.shape[-1]
        require_last_dim("reference (joint position and velocity)", reference, 2 * count)
        self._check_size(count)
        continuous = continuous_joints(count, self.continuous).to(position.device)
        effort = joint_effort(
            joint_difference(reference[..., :count], position, continuous),
            reference[..., count:] - velocity,
            self.stiffness.to(reference.dtype),
            self.damping.to(reference.dtype),
        )
        return tensordict.set(self.action_key, effort.to(reference.dtype))

    def _check_size(self, count: int) -> None:
        for name, gain in (("stiffness", self.stiffness), ("damping", self.damping)):
            if gain.numel() not in (1, count):
                raise ValueError(f"{name} has {gain.numel()} numbers; expected 1 or {count}, one for each joint.")

    def transform_action_spec(self, action_spec: Composite) -> Composite:
        """Outside, the action is a reference: D joint positions, then D joint velocities."""
        like = action_spec[self.action_key]
        self._check_size(like.shape[-1])
        spec = real(like, *like.shape[:-1], 2 * like.shape[-1])
        return replace_leaf(action_spec, self.action_key, spec, type(self).__name__)


def _gain(name: str, value: float | Sequence[float]) -> Tensor:
    gain = torch.as_tensor(value, dtype=torch.get_default_dtype()).reshape(-1)
    if not gain.numel() or not bool((gain >= 0).all() & gain.isfinite().all()):
        raise ValueError(f"{name} is {value}; expected one number, or one for each joint, finite and at least 0.")
    return gain
