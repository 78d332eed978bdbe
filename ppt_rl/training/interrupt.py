"""Ctrl-C as a request."""

from __future__ import annotations

import signal
import sys
import threading

__all__ = ["Interrupt"]


class Interrupt:
    """Turns the first Ctrl-C into a request that a loop can check; the second one interrupts at once.

    Attributes:
        requested: whether Ctrl-C was pressed.
    """

    def __init__(self) -> None:
        self.requested = False
        main = threading.current_thread() is threading.main_thread()
        self._old = signal.signal(signal.SIGINT, self._request) if main else None

    def _request(self, number: int, frame: object) -> None:
        if self.requested:
            raise KeyboardInterrupt
        self.requested = True
        message = "\nInterrupted: finishing the batch and writing a checkpoint; continue later with --resume.\n"
        sys.stderr.write(message)

    def restore(self) -> None:
        """Restore the former handler of Ctrl-C."""
        if self._old is not None:
            signal.signal(signal.SIGINT, self._old)
