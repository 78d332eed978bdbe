from __future__ import annotations

import re
from collections import Counter

import pytest
import torch

from ppt_rl.functional.checks import require_positive
from tests.bad_inputs import (
    archives,
    chains,
    commands,
    environments,
    functions,
    layouts,
    parts,
    results,
    transforms,
)
from tests.bad_inputs.entry import BadCommand, BadInput
from tests.bad_inputs.files import write_broken_files
from tests.bad_inputs.refusal import command_refusal, input_refusal

TABLES = (archives, chains, commands, environments, functions, layouts, parts, results, transforms)
ENTRIES = [entry for table in TABLES for entry in table.ENTRIES]


@pytest.fixture(scope="session")
def broken_files(tmp_path_factory):
    """Folder of broken files for the command lines."""
    folder = tmp_path_factory.mktemp("broken")
    write_broken_files(folder)
    return folder


def as_parameter(entry: BadInput | BadCommand) -> object:
    marks = [pytest.mark.xfail(reason="not refused well yet", strict=True)] if entry.pending else []
    return pytest.param(entry, id=re.sub(r"[^\x20-\x7e]|[\[\]:]", "_", entry.name), marks=marks)


@pytest.mark.parametrize("entry", [as_parameter(entry) for entry in ENTRIES])
def test_a_bad_input_is_refused_by_the_library_with_one_clear_message(entry, broken_files):
    message = command_refusal(entry, broken_files) if isinstance(entry, BadCommand) else input_refusal(entry)
    assert re.search(entry.match, message), f"the message does not match {entry.match!r}: {message}"


def test_the_tables_are_long_and_name_every_input_once():
    assert len(ENTRIES) >= 300
    assert not [name for name, count in Counter(entry.name for entry in ENTRIES).items() if count > 1]


def test_most_inputs_are_refused_well_today():
    assert sum(entry.pending for entry in ENTRIES) < len(ENTRIES) / 3


def unclear() -> None:
    raise ValueError("no")


def by_torch() -> None:
    torch.zeros(2) + torch.zeros(3)


def hanging() -> None:
    while True:
        pass


@pytest.mark.parametrize(
    ("make", "problem"),
    [
        (lambda: None, "silently accepted"),
        (unclear, "raised by something else"),
        (by_torch, "raised by something else"),
        (lambda: require_positive("dt", 0.0, "s\ns"), "several lines"),
        (hanging, "not refused within 0.2 s"),
    ],
)
def test_what_is_accepted_or_unclear_or_hangs_does_not_count_as_refused(make, problem):
    with pytest.raises(AssertionError, match=problem):
        input_refusal(BadInput("a probe", make, ""), seconds=0.2)


@pytest.mark.parametrize(("args", "problem"), [(("policies",), "silently accepted"), (("--help",), "status 0")])
def test_a_command_that_runs_does_not_count_as_refused(args, problem, broken_files):
    with pytest.raises(AssertionError, match=problem):
        command_refusal(BadCommand(args, ""), broken_files)
