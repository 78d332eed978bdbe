"""The account of a tank: a level that nobody else can raise, settled by what the effort has really delivered."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor

from ppt_rl.functional.checks import is_readable
from ppt_rl.transforms.base import ActionTransform, merged
from ppt_rl.transforms.tank_inputs import beside_key, require_level

__all__ = ["TankAccountTransform"]


class TankAccountTransform(ActionTransform):
    r"""An action transform with a level of energy, which its law lowers before a step.

    With a ``position_key`` the level is settled after the step. An effort that is held delivers exactly
    ``effort . (q' - q)``, whatever contact or Coriolis forces did to the velocity in between. Where that is more than
    the law took, the level pays the rest D, and what it cannot pay stays as a debt B, which later income pays first:

    .. math::
        D &= \max\big(0,\ \mathrm{effort} \cdot (q' - q) - (E - E_{law})\big) \\
        E' - B' &= E_{law} - D - B, \qquad E' \ge 0,\ B' \ge 0,\ E' B' = 0

    Hence over an episode ``sum effort . (q' - q) <= E_0 - E + B``, up to the rounding of the positions. Without an
    environment nothing is settled.

    A subclass sets the attributes below, takes the level from :meth:`_level` and the effort to :meth:`_hold` on the way
    in, and calls :meth:`_settle` after a step.

    Args:
        action_key: the action, read and written in place.
    """

    #: Capacity [J].
    e_max: float
    #: Where the level [J] is found.
    energy_key: NestedKey
    #: Where the position q is found, whose rate the effort works on; None settles nothing.
    position_key: NestedKey | None = None

    @property
    def debt_key(self) -> NestedKey | None:
        """Where the debt B ``(*B, 1)`` [J] is written: beside the level."""
        return None if self.position_key is None else beside_key(self.energy_key, "debt")

    def _level(self, tensordict: TensorDictBase, effort: Tensor) -> Tensor:
        """The level at the beginning of the step ``(*B, 1)`` [J]; without an environment, a missing one is full."""
        given = tensordict.get(self.energy_key, None)
        if given is None:
            if self.parent is None:
                return torch.full_like(effort[..., :1], self.e_max)
            raise KeyError(
                f"EnergyTankTransform finds no level {self.energy_key!r} in the tensordict; expected the one that "
                "reset or the last step returned. Step from their tensordict, and select this entry too."
            )
        own = self._remembered(tensordict, self.energy_key)
        if own is not None and is_readable(own) and torch.equal(given, own):
            return own
        shape = (*effort.shape[:-1], 1)
        require_level(self.energy_key, given, own, self.e_max, shape, self._stepping(tensordict))
        return given if own is None else torch.minimum(given, own)

    def _hold(self, tensordict: TensorDictBase, effort: Tensor) -> None:
        """Keep the effort that is held during the step."""
        if self.position_key is None or self.debt_key is None or self.parent is None:
            return
        (position,) = self._recall(tensordict, self.position_key)
        if position.shape != effort.shape:
            raise ValueError(
                f"the position {self.position_key!r} has shape {tuple(position.shape)} and the effort "
                f"{self.action_key!r} {tuple(effort.shape)}; expected the same, a number for each axis of the effort. "
                "Leave position_key out for a wrench."
            )
        self._stash(tensordict, self.debt_key, effort)

    def _settle(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> None:
        """Pay the rest for a step; ``next_tensordict`` has the level after the law's price."""
        if self.position_key is None or self.debt_key is None:
            return
        effort = self._stashed(tensordict, self.debt_key)
        before, start, debt = self._recall(tensordict, self.energy_key, self.position_key, self.debt_key)
        (end,) = self._require(next_tensordict, self.position_key)
        after = next_tensordict.get(self.energy_key)
        delivered = (effort * (end - start)).sum(-1, keepdim=True)
        balance = after - debt - (delivered - (before - after)).clamp_min(0.0)
        rows = self._stepping(tensordict)
        for key, new, old in (
            (self.energy_key, balance.clamp_min(0.0), after),
            (self.debt_key, (-balance).clamp_min(0.0), debt),
        ):
            next_tensordict.set(key, new if rows is None else merged(rows, new, old))
