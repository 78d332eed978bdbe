"""Contact-safe reinforcement learning in TorchRL: ProMPs, PPO and an energy tank on a simulated arm."""

from __future__ import annotations

from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ppt_rl.evaluation import Policy, load_policy

__all__ = ["Policy", "__version__", "load_policy"]


def __getattr__(name: str) -> Any:
    """Import public names when they are first used, so that ``import ppt_rl`` stays quick."""
    if name == "__version__":
        return version("ppt_rl")
    if name in __all__:
        from ppt_rl import evaluation

        return getattr(evaluation, name)
    raise AttributeError(f"module 'ppt_rl' has no attribute {name!r}; it has {__all__} and its subpackages.")


def __dir__() -> list[str]:
    """Public names."""
    return [*globals(), *__all__]
