"""Where results go, checked before the work that makes them."""

from __future__ import annotations

import tempfile
from pathlib import Path

__all__ = ["require_folder"]


def require_folder(option: str, folder: Path) -> None:
    """Create a folder; raise unless files can be written into it.

    Args:
        option: name of the option, for the error message.
        folder: the folder.

    Raises:
        ValueError: if it is something else, or nothing can be written there.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as trial:
            trial.write(b"\0")
    except OSError as error:
        raise ValueError(
            f"{option} is {folder}, where nothing can be written ({error.strerror}); expected a folder. Name another."
        ) from error
