"""Options of the physics behind an environment."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Literal, get_args

import torch

from ppt_rl.envs.limits import require_count, require_within
from ppt_rl.functional.argument_checks import require_instance, require_number, shown
from ppt_rl.functional.checks import require_positive

__all__ = ["EngineConfig", "EngineName"]

#: ``threads`` is MuJoCo on CPU threads, ``warp`` MuJoCo Warp on a device; ``auto`` is ``warp`` on a GPU and ``threads``
#: elsewhere, unless the environment variable ``PPT_RL_ENGINE`` names one; worker processes inherit it.
EngineName = Literal["auto", "threads", "warp"]
_VARIABLE = "PPT_RL_ENGINE"


@dataclass(frozen=True)
class EngineConfig:
    """How an environment steps its physics.

    Attributes:
        physics_dt: time step of the physics [s], 0.01 to 20 ms; it must divide the environment's ``control_dt``.
        num_threads: threads of the physics, at most 1024; None takes one for each CPU. The number never changes a
            result.
        name: which engine.
        contacts: room for contacts, for each environment of the engine ``warp``, 1 to 1000; a scene that needs more
            diverges.
        audit: whether power and work are measured at the rate of the physics (:mod:`ppt_rl.envs.audit`).

    Raises:
        ValueError: if a number is out of range, ``audit`` is no truth value, or there is no such engine.
    """

    physics_dt: float = 0.0005
    num_threads: int | None = None
    audit: bool = False
    name: EngineName = "auto"
    contacts: int = 24

    def __post_init__(self) -> None:
        """Refuse an impossible time step or number of threads."""
        require_positive("physics_dt", self.physics_dt, "s")
        require_within("physics_dt", self.physics_dt, (1e-5, 0.02, "s"))
        if self.num_threads is not None:
            expected = "at least 1, or None for one for each CPU"
            if require_number("num_threads", self.num_threads, expected) < 1:
                raise ValueError(f"num_threads is {self.num_threads}; expected {expected}.")
            require_count("num_threads", self.num_threads, 1024)
        require_instance("audit", self.audit, bool)
        if self.name not in get_args(EngineName):
            raise ValueError(f"engine is {shown(self.name)}; expected one of {list(get_args(EngineName))}.")
        require_count("contacts", self.contacts, 1000)

    @classmethod
    def of(cls, engine: EngineConfig | EngineName | None) -> EngineConfig:
        """Options from what an environment was given: options, the name of an engine, or None for the defaults.

        Args:
            engine: what it was given.

        Returns:
            The options.

        Raises:
            ValueError: if it is neither, or there is no such engine.
        """
        if engine is None:
            return cls()
        if isinstance(engine, str):
            return cls(name=engine)
        require_instance("engine", engine, EngineConfig)
        return engine

    def on(self, device: torch.device) -> Literal["threads", "warp"]:
        """The engine to take for an environment on a device.

        Args:
            device: device of what the environment returns.

        Returns:
            Its name.

        Raises:
            ValueError: if the environment variable ``PPT_RL_ENGINE`` names no engine.
        """
        name = os.environ.get(_VARIABLE, "auto") if self.name == "auto" else self.name
        if name not in get_args(EngineName):
            raise ValueError(f"{_VARIABLE} is {shown(name)}; expected one of {list(get_args(EngineName))}.")
        if name == "auto":
            return "warp" if device.type == "cuda" else "threads"
        return name  # type: ignore[return-value]
