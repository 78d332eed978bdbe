"""Limits of power and energy that a policy or a schedule gives for each step."""

from __future__ import annotations

from tensordict import TensorDictBase
from tensordict.utils import NestedKey, unravel_key
from torch import Tensor

from ppt_rl.transforms.base import ActionTransform
from ppt_rl.transforms.tank_inputs import limit_within

__all__ = ["StepLimitsTransform"]

#: Where the limits that this transform holds are stored on the parent, by key; the parent belongs to it alone.
_HELD = "_held_limits_of_tank"


class StepLimitsTransform(ActionTransform):
    """An action transform whose limits may come per step; a subclass sets the numbers and the keys below.

    Args:
        action_key: the action, read and written in place.
    """

    #: Hard bounds of the power [W] and of the capacity [J].
    p_max: float
    e_max: float
    #: Where the limits of a step are found; None takes the hard bound always.
    p_max_key: NestedKey | None = None
    e_max_key: NestedKey | None = None

    def _limit(self, tensordict: TensorDictBase, key: NestedKey | None, most: float, effort: Tensor) -> float | Tensor:
        """A limit of this step: its hard bound, or what the tensordict says ``(*B, 1)``."""
        if key is None:
            return most
        given = tensordict.get(key, None)
        if given is None:
            if self.parent is None:
                return most
            raise KeyError(
                f"{type(self).__name__} finds no limit {key!r} in the tensordict; expected the one that reset or the "
                "last step returned, or a policy's own. Step from their tensordict, and select this entry too."
            )
        limit = limit_within(key, given, most, effort)
        if self.parent is not None and key in self._held():
            self._stash(tensordict, key, limit)
        return limit

    def _held(self) -> dict[NestedKey, float]:
        """Limits per step that are part of this tank's state, with their hard bounds: those nobody else observes."""
        own, parent = {self.p_max_key: self.p_max, self.e_max_key: self.e_max}, self.parent
        if own.keys() == {None}:
            return {}
        if _HELD not in parent.__dict__:
            others = parent.full_observation_spec.keys(True, True)
            parent.__dict__[_HELD] = {
                key: most for key, most in own.items() if key is not None and unravel_key(key) not in others
            }
        return parent.__dict__[_HELD]
