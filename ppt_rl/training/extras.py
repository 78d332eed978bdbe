"""Packages that the library does without unless they are asked for."""

from __future__ import annotations

import importlib.util

__all__ = ["MissingPackage", "require_package"]


class MissingPackage(ImportError):
    """An optional package is needed and not installed."""


def require_package(name: str, extra: str, purpose: str) -> None:
    """Raise unless an optional package is installed.

    Args:
        name: name that it is imported by.
        extra: the extra of ppt_rl that brings it.
        purpose: what needs it, for the error message.

    Raises:
        MissingPackage: if it is not installed.
    """
    if importlib.util.find_spec(name) is None:
        raise MissingPackage(
            f"{purpose} needs the package {name}, which is not installed; expected it beside ppt_rl. "
            f"Install it with: pip install 'ppt_rl[{extra}]'"
        )
