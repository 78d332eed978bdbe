"""Command lines: typed options, and errors that read like advice instead of a traceback."""

from __future__ import annotations

import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import tyro

from ppt_rl.training.advice import advice_on
from ppt_rl.training.checkpoint import CheckpointMismatch
from ppt_rl.training.extras import MissingPackage
from ppt_rl.training.finite import TrainingDiverged
from ppt_rl.training.output import drop_closed_output, tell

__all__ = ["advice_instead_of_traceback", "run_script"]


@contextmanager
def advice_instead_of_traceback(prog: str) -> Iterator[None]:
    """End the program with one line of advice instead of a traceback where the user can mend what failed.

    The status is 2 after a wrong value, an unfit checkpoint, a training that diverged or a file that cannot be read or
    written; 130, 143 or 129 after Ctrl-C, SIGTERM or SIGHUP; 141 where the reader of the output has gone. Warnings take
    one line too.

    Args:
        prog: name of the program, for the message.
    """
    warnings.filterwarnings("ignore", category=FutureWarning, module="torchrl")
    with _one_line_each(prog):
        try:
            yield
            sys.stdout.flush()
        except KeyboardInterrupt as error:
            raise SystemExit(getattr(error, "exit_status", 128 + signal.SIGINT)) from None
        except BrokenPipeError:
            drop_closed_output()
            raise SystemExit(128 + signal.SIGPIPE) from None
        except (CheckpointMismatch, MissingPackage, TrainingDiverged, ValueError, KeyError) as error:
            tell(f"{prog}: error: {error.args[0] if error.args else error}")
            raise SystemExit(2) from error
        except OSError as error:
            tell(f"{prog}: error: {advice_on(error)}")
            raise SystemExit(2) from error


@contextmanager
def _one_line_each(prog: str) -> Iterator[None]:
    """Warnings of one line; a thread that cannot write says nothing, since the next write tells the program."""
    formatted, hook = warnings.formatwarning, threading.excepthook
    warnings.formatwarning = lambda message, *args, **kwargs: f"{prog}: warning: {message}\n"
    threading.excepthook = lambda args: None if isinstance(args.exc_value, OSError) else hook(args)
    try:
        yield
    finally:
        warnings.formatwarning, threading.excepthook = formatted, hook


def run_script(
    main: Callable[[Any], Any], options: type, args: Sequence[str] | None = None, prog: str | None = None,
    default: Callable[[Sequence[str]], Any] | None = None,
) -> None:  # fmt: skip
    """Parse options and run a program, with :func:`advice_instead_of_traceback`.

    Args:
        main: called with the parsed options.
        options: dataclass with documented fields.
        args: command line; None takes that of the process.
        prog: name of the program in its help; None takes that of the process.
        default: from the command line, options whose values stand where it names no others, or None for those of the
            dataclass.
    """
    args = sys.argv[1:] if args is None else args
    with advice_instead_of_traceback(prog or sys.argv[0]):
        given = default(args) if default is not None else None
        main(tyro.cli(options, args=args, prog=prog, **({} if given is None else {"default": given})))
