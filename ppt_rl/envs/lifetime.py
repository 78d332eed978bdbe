"""The life of an environment: it opens, begins episodes, may be copied, and closes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor
from torchrl.envs import EnvBase

__all__ = ["Lifetime"]


class Lifetime(EnvBase):
    """Base of an environment with an engine and a renderer: calls in an impossible order are errors.

    A copy (``copy.deepcopy``, ``pickle``) has an engine of its own and continues like the original: same states, same
    parameters, same next episodes. A closed environment can be copied too, but neither reset, stepped nor rendered.
    """

    num_envs: int
    engine: Any
    _free_renderer: Callable[[], None]

    def _open(self, device: torch.device) -> None:
        """Call this once the engine runs."""
        self._begun = torch.zeros(self.num_envs, dtype=torch.bool, device=device)  # whether it was ever reset
        self._all_begun = False
        self.is_closed = False

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Stop the physics threads and free the renderer.

        Args:
            raise_if_closed: whether closing twice is an error.

        Raises:
            RuntimeError: if the environment is closed already.
        """
        if self.is_closed:
            if raise_if_closed:
                raise RuntimeError(
                    f"{type(self).__name__} is closed already; expected an open one. Where it may be closed, call "
                    "close(raise_if_closed=False)."
                )
            return
        self.engine.close()
        self._free_renderer()
        super().close(raise_if_closed=raise_if_closed)

    def _require_open(self) -> None:
        if self.is_closed:
            raise RuntimeError(
                f"{type(self).__name__} is closed, so its physics threads have stopped; expected an open one. Make a "
                "new environment, and close it after its last use only (a collector closes its own at shutdown)."
            )

    def _mark_begun(self, mask: Tensor | None) -> None:
        if self._all_begun:
            return
        self._begun |= True if mask is None else mask
        self._all_begun = mask is None or bool(self._begun.all())

    def _require_begun(self, mask: Tensor | None) -> None:
        if self._all_begun:
            return
        waiting = ~self._begun if mask is None else mask & ~self._begun
        if bool(waiting.any()):
            raise RuntimeError(
                f"{type(self).__name__} is stepped before its first reset (environments "
                f"{waiting.nonzero().flatten().tolist()}); expected an episode that has begun. Call env.reset() and "
                "step from the tensordict that it returns."
            )

    def __getstate__(self) -> dict[str, Any]:
        """What a copy takes along: everything but the renderer, which it makes anew, and the collector."""
        return {**self.__dict__, "_rendered": None, "_collector": None}
