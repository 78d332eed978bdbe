"""Ctrl-C, SIGTERM and SIGHUP as a request."""

from __future__ import annotations

import signal
import sys
import threading

from ppt_rl.training.output import despite_closed_output

__all__ = ["Interrupt", "Interrupted"]

#: Ctrl-C, the request of a batch system or of `kill`, and a terminal that was closed.
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Interrupted(KeyboardInterrupt):
    """Raised in the place of KeyboardInterrupt; it knows the signal that interrupted.

    Args:
        number: the signal.

    Attributes:
        exit_status: status of a program that ends with it: 130 after Ctrl-C, 143 after SIGTERM, 129 after SIGHUP.
    """

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.exit_status = 128 + number


class Interrupt:
    """Turns the first Ctrl-C, SIGTERM or SIGHUP into a request that a loop can check; the second interrupts at once.

    A SIGHUP that is ignored already, as under ``nohup``, stays so. Signals reach the main thread only; in another one
    nothing is requested.

    Attributes:
        requested: the signal that came, or None.
    """

    def __init__(self) -> None:
        self.requested: int | None = None
        main = threading.current_thread() is threading.main_thread()
        wanted = [number for number in _SIGNALS if main and not _is_ignored(number)]
        self._old = {number: signal.signal(number, self._request) for number in wanted}

    def _request(self, number: int, frame: object) -> None:
        if self.requested is not None:
            raise Interrupted(number)
        self.requested = number
        message = "\nInterrupted: finishing the batch and writing a checkpoint; continue later with --resume.\n"
        with despite_closed_output():
            sys.stderr.write(message)

    def restore(self) -> None:
        """Restore the former handlers."""
        for number, handler in self._old.items():
            signal.signal(number, handler)

    def raise_if_requested(self) -> None:
        """End a loop that was interrupted.

        Raises:
            Interrupted: if a signal came.
        """
        if self.requested is not None:
            raise Interrupted(self.requested)


def _is_ignored(number: signal.Signals) -> bool:
    return number == signal.SIGHUP and signal.getsignal(number) == signal.SIG_IGN
