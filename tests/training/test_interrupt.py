from __future__ import annotations

import os
import pty
import signal
import subprocess
import sys
import termios
import time
from contextlib import suppress

import pytest

from ppt_rl.training import find_checkpoint
from ppt_rl.training.interrupt import Interrupt, Interrupted
from ppt_rl.training.output import despite_closed_output
from tests.training.tiny import OPTIONS, RECIPE, forked

STATUS = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGHUP: 129}


def wait_for(path, seconds=60):
    deadline = time.monotonic() + seconds
    while not path.exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    assert path.exists()


def ended(child, seconds=60):
    """Status of a child, which is killed if it does not end."""
    deadline = time.monotonic() + seconds
    while not (found := os.waitpid(child, os.WNOHANG))[0] and time.monotonic() < deadline:
        time.sleep(0.02)
    if not found[0]:
        os.kill(child, signal.SIGKILL)
        found = os.waitpid(child, 0)
    return os.waitstatus_to_exitcode(found[1])


def endless(run_dir):
    """A training that writes no checkpoint before it is interrupted."""
    RECIPE.main(["--run-dir", str(run_dir), *OPTIONS, "--ppo.checkpoint-every", "1000000"])


@pytest.mark.parametrize("number", STATUS)
def test_a_signal_ends_a_training_after_its_batch_with_a_checkpoint_and_the_status_of_the_signal(tmp_path, number):
    child = forked(lambda: endless(tmp_path / "run"), tmp_path / "output")
    wait_for(tmp_path / "run" / "logs" / "csv" / "scalars" / "success.csv")
    os.kill(child, number)
    assert ended(child) == STATUS[number]
    assert find_checkpoint(tmp_path / "run").exists()
    said = (tmp_path / "output").read_text()
    assert said.count("continue later with --resume") == 1
    assert "Traceback" not in said


def test_a_terminal_that_is_closed_ends_a_training_with_a_checkpoint(tmp_path):
    child, terminal = pty.fork()
    if not child:
        in_terminal(tmp_path / "run")
    termios.tcsetwinsize(terminal, (24, 80))
    os.set_blocking(terminal, False)
    scalar, said = tmp_path / "run" / "logs" / "csv" / "scalars" / "success.csv", b""
    deadline = time.monotonic() + 60
    while not scalar.exists() and time.monotonic() < deadline:
        time.sleep(0.02)
        with suppress(BlockingIOError):
            said += os.read(terminal, 100_000)
    os.close(terminal)
    try:
        assert b"steps/s" in said  # it did write to the terminal
        assert ended(child) == 129
        assert find_checkpoint(tmp_path / "run").exists()
    finally:
        with suppress(ProcessLookupError):
            os.kill(child, signal.SIGKILL)


def in_terminal(run_dir):
    """Train as the first process of a terminal, and end this process."""
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    sys.stdout, sys.stderr = open(1, "w", closefd=False), open(2, "w", buffering=1, closefd=False)  # noqa: SIM115
    status = 99
    try:
        endless(run_dir)
    except SystemExit as end:
        status = end.code
    finally:
        os._exit(status)


def test_the_second_signal_interrupts_at_once_and_the_first_does_not():
    interrupt = Interrupt()
    try:
        signal.raise_signal(signal.SIGTERM)
        assert interrupt.requested == signal.SIGTERM
        with pytest.raises(Interrupted) as caught:
            signal.raise_signal(signal.SIGINT)
        assert caught.value.exit_status == 130
        with pytest.raises(KeyboardInterrupt) as first:
            interrupt.raise_if_requested()
        assert first.value.exit_status == 143
    finally:
        interrupt.restore()


def test_the_former_handlers_come_back():
    before = {number: signal.getsignal(number) for number in STATUS}
    interrupt = Interrupt()
    assert all(signal.getsignal(number) != before[number] for number in STATUS)
    interrupt.restore()
    assert {number: signal.getsignal(number) for number in STATUS} == before


def test_a_hangup_that_is_ignored_stays_ignored():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        interrupt = Interrupt()
        signal.raise_signal(signal.SIGHUP)
        assert interrupt.requested is None
        interrupt.restore()
    finally:
        signal.signal(signal.SIGHUP, before)


def test_what_nobody_reads_any_more_ends_no_run():
    code = """
import sys
from ppt_rl.training.output import despite_closed_output, tell
sys.stdin.read()
for _ in range(3):
    with despite_closed_output():
        print("x" * 100_000, file=sys.stderr, flush=True)
    tell("more")
print("done", flush=True)
"""
    run = subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    run.stderr.close()
    run.stdin.close()
    assert run.stdout.read() == "done\n"
    assert run.wait() == 0


def test_other_errors_pass_while_something_is_said():
    with pytest.raises(ZeroDivisionError), despite_closed_output():
        1 / 0  # noqa: B018
