"""Command lines: typed options, and errors that read like advice instead of a traceback."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import tyro

from ppt_rl.training.checkpoint import CheckpointMismatch

__all__ = ["advice_instead_of_traceback", "run_script"]


@contextmanager
def advice_instead_of_traceback(prog: str) -> Iterator[None]:
    """End the program with one message and status 2 after a wrong value or an unfit checkpoint, with 130 after Ctrl-C.

    Args:
        prog: name of the program, for the message.
    """
    warnings.filterwarnings("ignore", category=FutureWarning, module="torchrl")
    try:
        yield
    except KeyboardInterrupt:
        raise SystemExit(130) from None
    except (CheckpointMismatch, ValueError, KeyError) as error:
        message = error.args[0] if error.args else error
        print(f"{prog}: error: {message}", file=sys.stderr)
        raise SystemExit(2) from error


def run_script(
    main: Callable[[Any], Any], options: type, args: Sequence[str] | None = None, prog: str | None = None
) -> None:
    """Parse options and run a program, with :func:`advice_instead_of_traceback`.

    Args:
        main: called with the parsed options.
        options: dataclass with documented fields.
        args: command line; None takes that of the process.
        prog: name of the program in its help; None takes that of the process.
    """
    with advice_instead_of_traceback(prog or sys.argv[0]):
        main(tyro.cli(options, args=args, prog=prog))
