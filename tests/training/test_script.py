from __future__ import annotations

import errno
import os
import subprocess
import sys
import threading
import warnings
from dataclasses import dataclass

import pytest

from ppt_rl.training import CheckpointMismatch, TrainingDiverged
from ppt_rl.training.advice import advice_on
from ppt_rl.training.interrupt import Interrupted
from ppt_rl.training.script import advice_instead_of_traceback, run_script

KNOWN = [
    "ENOSPC", "EDQUOT", "EFBIG", "EROFS", "EACCES", "EPERM", "ENOENT", "ENOTDIR", "EEXIST", "EISDIR", "ENAMETOOLONG",
    "ELOOP", "EMFILE", "ENFILE", "ENOMEM", "EIO",
]  # fmt: skip


def refused(name, path="runs/mine"):
    number = getattr(errno, name)
    return OSError(number, os.strerror(number), path)


@pytest.mark.parametrize("name", [*KNOWN, "EBUSY"])
def test_an_error_of_the_system_is_one_line_with_the_path_the_reason_and_a_remedy(name, capsys):
    with pytest.raises(SystemExit) as end, advice_instead_of_traceback("prog"):
        raise refused(name)
    reason = os.strerror(getattr(errno, name)).lower()
    (line,) = capsys.readouterr().err.splitlines()
    head, remedy = line.split("; ", 1)
    assert head == f"prog: error: runs/mine cannot be read or written: {reason}"
    assert len(remedy) > 15
    assert end.value.code == 2


def test_every_known_error_has_a_remedy_that_fits():
    assert "free some space; --resume goes on" in advice_on(refused("ENOSPC"))
    assert "choose another place" in advice_on(refused("EROFS"))
    assert "a part of it is missing" in advice_on(refused("ENOENT"))
    assert advice_on(OSError(errno.ENOSPC, "x")).startswith("a file cannot be read or written: no space left")
    assert advice_on(OSError("\n\nffmpeg says no\nmore")) == "ffmpeg says no"


@pytest.mark.parametrize("kind", [CheckpointMismatch, TrainingDiverged, ValueError, KeyError])
def test_a_mistake_is_one_line(kind, capsys):
    with pytest.raises(SystemExit) as end, advice_instead_of_traceback("prog"):
        raise kind("p_max is nan")
    assert capsys.readouterr().err == "prog: error: p_max is nan\n"
    assert end.value.code == 2


@pytest.mark.parametrize(
    ("error", "status"), [(KeyboardInterrupt(), 130), (Interrupted(15), 143), (Interrupted(1), 129)]
)
def test_an_interrupt_ends_with_its_own_status(error, status):
    with pytest.raises(SystemExit) as end, advice_instead_of_traceback("prog"):
        raise error
    assert end.value.code == status


def test_a_program_whose_reader_has_gone_ends_quietly():
    code = """
import sys
from ppt_rl.training.script import advice_instead_of_traceback
with advice_instead_of_traceback("prog"):
    sys.stdin.read()
    print("x" * 100)
"""
    run = subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    run.stdout.close()
    run.stdin.close()
    assert run.stderr.read() == ""
    assert run.wait() == 141


def test_a_warning_is_one_line_within_a_program_and_as_before_after_it(capsys):
    before = warnings.formatwarning
    with warnings.catch_warnings(), advice_instead_of_traceback("prog"):
        warnings.simplefilter("always")
        warnings.showwarning = lambda *args: sys.stderr.write(warnings.formatwarning(*args[:4]))
        warnings.warn("a checkpoint is damaged", stacklevel=1)
    assert capsys.readouterr().err == "prog: warning: a checkpoint is damaged\n"
    assert warnings.formatwarning is before


def test_a_thread_that_cannot_write_is_silent_and_other_threads_are_not(monkeypatch):
    seen = []
    monkeypatch.setattr(threading, "excepthook", lambda args: seen.append(args.exc_type))

    def fail(error):
        raise error

    with advice_instead_of_traceback("prog"):
        for error in (refused("ENOSPC"), ZeroDivisionError()):
            thread = threading.Thread(target=fail, args=(error,))
            thread.start()
            thread.join()
    assert seen == [ZeroDivisionError]


@dataclass(frozen=True)
class Options:
    """Options.

    Attributes:
        epochs: a number.
        clip: another.
    """

    epochs: int = 1
    clip: float = 0.5


def test_defaults_of_a_run_stand_where_the_command_line_names_no_others():
    seen = []
    run_script(seen.append, Options, ["--clip", "0.1"], "prog", lambda args: Options(7, 0.9))
    run_script(seen.append, Options, ["--clip", "0.1"], "prog", lambda args: None)
    run_script(seen.append, Options, [], "prog")
    assert seen == [Options(7, 0.1), Options(1, 0.1), Options()]
