"""Options of the physics behind an environment."""

from __future__ import annotations

from dataclasses import dataclass

from ppt_rl.envs.limits import require_count, require_within
from ppt_rl.functional.argument_checks import require_instance, require_number
from ppt_rl.functional.checks import require_positive

__all__ = ["EngineConfig"]


@dataclass(frozen=True)
class EngineConfig:
    """How an environment steps its physics.

    Attributes:
        physics_dt: time step of the physics [s], 0.01 to 20 ms; it must divide the environment's ``control_dt``.
        num_threads: threads of the physics, at most 1024; None takes one for each CPU. The number never changes a
            result.
        audit: whether power and work are measured at the rate of the physics (:mod:`ppt_rl.envs.audit`).

    Raises:
        ValueError: if a number is out of range, or ``audit`` is no truth value.
    """

    physics_dt: float = 0.0005
    num_threads: int | None = None
    audit: bool = False

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
