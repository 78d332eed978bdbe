"""How an input was refused: runs an entry under a time limit and checks the form of the refusal."""

from __future__ import annotations

import contextlib
import io
import linecache
import re
import resource
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from types import FrameType, TracebackType
from unittest.mock import patch

import ppt_rl
from ppt_rl import cli, evaluation
from ppt_rl.evaluation import Policy, load_policy, published_policies
from tests.bad_inputs.entry import BadCommand, BadInput
from tests.bad_inputs.shared import policy

__all__ = ["SECONDS", "command_refusal", "input_refusal"]

#: An input must be refused within this time of the processor [s], and with at most this much more memory [bytes].
SECONDS, MEMORY = 5.0, 2 << 30
#: Time on the clock within which it must be refused on a busy machine, as a multiple of the time of the processor [-].
_BUSY = 20.0
#: tyro's frame, with and without box characters.
_FRAME = re.compile(r"╭|^ -{10,} $", re.MULTILINE)
_HOME = Path(ppt_rl.__file__).resolve().parent
_OURS = (_HOME, _HOME.parent / "recipes")
#: What a refusal may be.
_KINDS = (ValueError, KeyError, TypeError, RuntimeError)
#: What says how to go on: what was expected, or an imperative at the beginning of a sentence or clause.
_VERBS = (
    "Add|Append|Ask|Change|Check|Choose|Continue|Free|Give|Install|Lea(?:ve|rn)|Look|Make|Move|Name|Pass|Put|Raise|Remove|Repair|Run|"
    "Set|Shorten|Take|Train|Use|Widen|Write"
)
_ADVICE = re.compile(rf"\b(?:expected|needs)\b|(?:^|[.;:,] )(?:{_VERBS})\b|; (?:{_VERBS.lower()})\b")


class TooSlow(BaseException):
    """An entry took too long; no handler of ordinary errors catches it."""


def input_refusal(entry: BadInput, seconds: float = SECONDS) -> str:
    """The message with which a bad input is refused, after its form was checked.

    Args:
        entry: the entry.
        seconds: time limit [s].
    """
    refusal: Exception | None = None
    try:
        with _bounded(seconds):
            entry.make()
    except _KINDS as error:
        refusal = error
    except TooSlow:
        raise AssertionError(f"not refused within {seconds:g} s") from None
    assert refusal is not None, "silently accepted"
    message = str(refusal.args[0] if refusal.args else refusal)
    assert _raised_by_us(refusal.__traceback__), f"raised by something else than the library: {message}"
    return _checked(message)


def command_refusal(entry: BadCommand, tmp: Path) -> str:
    """What a bad command line prints on standard error, after its form was checked.

    Args:
        entry: the entry.
        tmp: folder of broken files.
    """
    args = ["ppt-rl", *(arg.replace("{tmp}", str(tmp)) for arg in entry.args)]
    out, err, old = io.StringIO(), io.StringIO(), sys.argv
    status: object = None
    try:
        sys.argv = args
        with (
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(err),
            contextlib.chdir(tmp),
            patch.object(evaluation, "load_policy", _load_policy),
            _bounded(SECONDS),
        ):
            cli.main()
    except SystemExit as end:
        status = end.code
    except TooSlow:
        raise AssertionError(f"not refused within {SECONDS:g} s") from None
    finally:
        sys.argv = old
    text = err.getvalue()
    assert status is not None, f"silently accepted; it printed {out.getvalue()!r}"
    assert status == 2, f"status {status}: {text}"
    assert "Traceback" not in text
    if _FRAME.search(text):  # of tyro, around an option that it does not know, or a value that is of another type
        return " ".join(text.split())
    lines = [line for line in text.splitlines() if line.strip()]
    assert len(lines) == 1, f"{len(lines)} lines: {text}"
    return _checked(lines[0])


def _load_policy(source: str, *, recipe: str | None = None) -> Policy:
    """The same as the library's, but a published policy is loaded only once."""
    return policy(source) if recipe is None and source in published_policies() else load_policy(source, recipe=recipe)


def _checked(message: str) -> str:
    assert "\n" not in message.strip(), f"several lines: {message}"
    assert _ADVICE.search(message), f"the message does not say what was expected or what to do: {message}"
    return message


def _raised_by_us(traceback: TracebackType | None) -> bool:
    """Whether it was a ``raise`` in a file of the library: a function written in C leaves no frame of its own."""
    assert traceback is not None
    while traceback.tb_next is not None:
        traceback = traceback.tb_next
    file = traceback.tb_frame.f_code.co_filename
    is_raise = linecache.getline(file, traceback.tb_lineno).strip().startswith("raise ")
    return is_raise and any(home in Path(file).resolve().parents for home in _OURS)


@contextlib.contextmanager
def _bounded(seconds: float) -> Iterator[None]:
    """Limits time and memory of what runs inside."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise TooSlow

    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    limits = resource.getrlimit(resource.RLIMIT_AS)
    timers = {signal.ITIMER_PROF: signal.SIGPROF, signal.ITIMER_REAL: signal.SIGALRM}
    handlers = {number: signal.signal(number, stop) for number in timers.values()}
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, limits[1]))
    signal.setitimer(signal.ITIMER_PROF, seconds)
    signal.setitimer(signal.ITIMER_REAL, _BUSY * seconds)
    try:
        yield
    finally:
        for timer in timers:
            signal.setitimer(timer, 0)
        resource.setrlimit(resource.RLIMIT_AS, limits)
        for number, handler in handlers.items():
            signal.signal(number, handler)
