from __future__ import annotations

import errno
import math
import os
import warnings

import pytest
import torch
from torch import nn

from ppt_rl.evaluation import load_policy
from ppt_rl.training import CheckpointMismatch, TrainingDiverged
from ppt_rl.training.checkpoint import (
    all_checkpoints,
    checkpoint_info,
    find_checkpoint,
    load_checkpoint,
    newest_checkpoint,
    save_checkpoint,
    step_of,
)
from tests.training.tiny import flip, train, write


def test_the_newest_checkpoints_and_the_best_are_kept(tmp_path):
    write(tmp_path, 10, success=0.5)
    write(tmp_path, 20, 30, 40)
    assert [step_of(path) for path in all_checkpoints(tmp_path)] == [40, 30, 10]
    assert step_of(find_checkpoint(tmp_path)) == 40


def test_every_flipped_byte_of_a_checkpoint_is_refused_or_harmless(tmp_path):
    (path,) = write(tmp_path, 10)
    data, info = path.read_bytes(), checkpoint_info(path)
    refused = 0
    for place in range(0, len(data), max(1, len(data) // 400)):
        flip(path, place)
        net = nn.Linear(4, 3)
        try:
            found = checkpoint_info(path)
            values = load_checkpoint(path, {"net": net, "counters": {}})
        except CheckpointMismatch:
            refused += 1
        else:
            assert (found, values["counters"]) == (info, {"step": 10})
            assert torch.equal(net.weight, torch.full((3, 4), 10.0))
        path.write_bytes(data)
    assert refused > 100


@pytest.mark.parametrize("length", [0, 1, 1000, -1])
def test_a_truncated_checkpoint_is_refused(tmp_path, length):
    (path,) = write(tmp_path, 10)
    path.write_bytes(path.read_bytes()[:length])
    with pytest.raises(CheckpointMismatch, match=r"may be truncated\. Use another checkpoint of the run"):
        checkpoint_info(path)


@pytest.mark.parametrize("damage", ["flip", "cut", "empty"])
def test_a_run_with_a_damaged_checkpoint_falls_back_to_the_one_before_and_says_so(tmp_path, damage):
    good, newest = write(tmp_path, 10, 20)
    if damage == "flip":
        flip(newest, newest.read_bytes().index(b"\x00\x00\xa0\x41" * 12))  # the weights, all of them 20
    else:
        newest.write_bytes(newest.read_bytes()[: 500 if damage == "cut" else 0])
    expected = "checkpoint-000000000020.torchrl cannot be read; checkpoint-000000000010.torchrl is taken in its place"
    with pytest.warns(UserWarning, match=expected) as told:
        assert find_checkpoint(tmp_path) == good
    assert len(told) == 1


def test_a_run_without_damage_warns_of_nothing(tmp_path):
    write(tmp_path, 10, 20)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert step_of(newest_checkpoint(tmp_path)) == 20


def test_a_run_whose_checkpoints_are_all_damaged_is_refused_with_what_to_do(tmp_path):
    for path in write(tmp_path, 10, 20):
        path.write_bytes(b"")
    with pytest.raises(CheckpointMismatch, match=r"holds 2 checkpoints and none can be read: .* start another run"):
        find_checkpoint(tmp_path)


def test_a_run_without_checkpoints_has_no_newest_one(tmp_path):
    assert newest_checkpoint(tmp_path) is None
    with pytest.raises(CheckpointMismatch, match="holds no checkpoint; expected a checkpoint, or a run's directory"):
        find_checkpoint(tmp_path)


def test_a_policy_is_loaded_from_the_newest_checkpoint_of_its_run_that_can_be_read(tmp_path):
    train(tmp_path, 2)
    newest, before = all_checkpoints(tmp_path)
    expected = load_policy(before)
    flip(newest, newest.stat().st_size // 2)
    with pytest.warns(UserWarning, match=f"{before.name} is taken in its place"):
        policy = load_policy(tmp_path)
    for a, b in zip(policy.actor.parameters(), expected.actor.parameters(), strict=True):
        assert torch.equal(a, b)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_state_that_is_not_finite_is_never_written(tmp_path, bad):
    write(tmp_path, 10)
    net = nn.Linear(4, 3)
    net.bias.data[0] = bad
    with pytest.raises(TrainingDiverged, match=r"net\.bias is not finite"):
        save_checkpoint(tmp_path, {"net": net}, step=20, metadata={"success": 0.0})
    assert [step_of(path) for path in all_checkpoints(tmp_path)] == [10]


def test_a_checkpoint_with_nan_in_it_is_not_loaded(tmp_path, monkeypatch):
    monkeypatch.setattr("ppt_rl.training.checkpoint.first_not_finite", lambda state: None)
    net = nn.Linear(4, 3)
    net.bias.data[0] = math.nan
    path = save_checkpoint(tmp_path, {"net": net}, step=20, metadata={"success": 0.0})
    monkeypatch.undo()
    with pytest.raises(CheckpointMismatch, match=r"holds numbers that are not finite in net\.bias; use an older"):
        load_checkpoint(path, {"net": nn.Linear(4, 3)})


def test_a_full_disk_is_found_before_anything_is_written(tmp_path, monkeypatch):
    write(tmp_path, 10)
    asked = []

    def full(number, start, size):
        asked.append(size)
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(OSError, match="No space left") as caught:
        write(tmp_path, 20)
    assert caught.value.filename == str(tmp_path / "checkpoints")
    assert asked[0] > 2 * all_checkpoints(tmp_path)[0].stat().st_size
    assert [path.name for path in (tmp_path / "checkpoints").iterdir()] == ["checkpoint-000000000010.torchrl"]


def test_a_file_system_without_reservations_takes_checkpoints_too(tmp_path, monkeypatch):
    def unknown(number, start, size):
        raise OSError(errno.EOPNOTSUPP, os.strerror(errno.EOPNOTSUPP))

    monkeypatch.setattr(os, "posix_fallocate", unknown)
    assert len(write(tmp_path, 20)) == 1
