"""What a run says while it works; it goes on when nobody can hear it any more."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

__all__ = ["despite_closed_output", "drop_closed_output", "tell"]


def tell(message: str) -> None:
    """Say something in one line, on the standard error.

    Args:
        message: the line.
    """
    with despite_closed_output():
        print(message, file=sys.stderr)


@contextmanager
def despite_closed_output() -> Iterator[None]:
    """Write to the terminal, or to nowhere once it was closed or its reader has gone: that ends no run."""
    try:
        yield
    except OSError:
        drop_closed_output()


def drop_closed_output() -> None:
    """Lead the standard output and error to nowhere where they are closed, so that what they still hold is dropped."""
    with open(os.devnull, "wb") as nowhere:
        for stream, number in ((sys.stdout, 1), (sys.stderr, 2)):
            try:
                stream.flush()
            except OSError:
                os.dup2(nowhere.fileno(), number)
                with suppress(OSError):
                    stream.flush()
