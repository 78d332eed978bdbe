from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from ppt_rl.training.logs import (
    RunLogs,
    read_scalar,
    remove_drafts,
    saved_config,
    write_bytes_atomically,
)


def steps(run_dir: Path) -> dict[str, list[int]]:
    """Steps of every scalar in TensorBoard's files."""
    events = EventAccumulator(str(run_dir / "logs" / "tensorboard"), size_guidance={"scalars": 0})
    events.Reload()
    return {name: [event.step for event in events.Scalars(name)] for name in events.Tags()["scalars"]}


def logged(run_dir: Path, *at: int, last_step: int = 0) -> None:
    """Log two scalars at some steps, from a step on."""
    logs = RunLogs(run_dir, last_step=last_step)
    for step in at:
        logs.write({"reward": step / 3, "success": 0.5}, step)
    logs.close()


def csv(run_dir: Path, name: str = "reward") -> Path:
    return run_dir / "logs" / "csv" / "scalars" / f"{name}.csv"


def test_every_log_holds_each_step_once_after_a_run_went_on_from_an_earlier_step(tmp_path):
    logged(tmp_path, 10, 20, 30, 40)
    logged(tmp_path, 30, 40, 50, last_step=20)
    logged(tmp_path, 50, 60, last_step=40)
    assert steps(tmp_path) == {name: [10, 20, 30, 40, 50, 60] for name in ("reward", "success")}
    assert read_scalar(tmp_path, "reward")[0].tolist() == [10, 20, 30, 40, 50, 60]


def test_values_come_back_as_they_were(tmp_path):
    logged(tmp_path, 10, 20)
    before = csv(tmp_path).read_text()
    logged(tmp_path, last_step=20)
    assert csv(tmp_path).read_text() == before
    assert read_scalar(tmp_path, "reward")[1].tolist() == [10 / 3, 20 / 3]
    events = EventAccumulator(str(tmp_path / "logs" / "tensorboard")).Reload()
    assert [event.value for event in events.Scalars("reward")] == pytest.approx([10 / 3, 20 / 3])


@pytest.mark.parametrize("torn", ["3", "30", "30,", "30,0.12", "30,0.12\n4", "\x00\x00\n", "30;1\n", ",\n", "\n"])
def test_a_line_that_a_kill_has_torn_is_dropped(tmp_path, torn):
    logged(tmp_path, 10, 20)
    with csv(tmp_path).open("a") as file:
        file.write(torn)
    logged(tmp_path, 30, last_step=20)
    assert read_scalar(tmp_path, "reward")[0].tolist() == [10, 20, 30]
    assert steps(tmp_path)["reward"] == [10, 20, 30]


def test_a_torn_step_is_not_taken_for_a_shorter_one(tmp_path):
    csv(tmp_path).parent.mkdir(parents=True)
    csv(tmp_path).write_text("1000,0.5\n20")
    logged(tmp_path, last_step=1000)
    assert csv(tmp_path).read_text() == "1000,0.5\n"


def test_events_that_were_never_written_out_are_there_after_the_run_went_on(tmp_path):
    logged(tmp_path, 10, 20)
    for path in (tmp_path / "logs" / "tensorboard").iterdir():
        path.write_bytes(path.read_bytes()[:60])
    logged(tmp_path, 30, last_step=20)
    assert steps(tmp_path)["success"] == [10, 20, 30]


def test_a_fresh_run_clears_the_logs_of_one_that_never_wrote_a_checkpoint(tmp_path):
    logged(tmp_path, 10, 20)
    RunLogs(tmp_path).close()
    assert steps(tmp_path) == {}
    assert not list(csv(tmp_path).parent.iterdir())


@pytest.mark.parametrize("content", [None, "", "{", "[]", '{"config": 3}', "\xff"])
def test_a_configuration_that_cannot_be_read_is_none(tmp_path, content):
    if content is not None:
        (tmp_path / "config.json").write_text(content, encoding="latin-1")
    assert saved_config(tmp_path) is None


# -- files -------------------------------------------------------------------------------------------------------------


def test_a_write_that_fails_leaves_the_old_file_and_no_draft(tmp_path, monkeypatch):
    path = tmp_path / "file"
    write_bytes_atomically(path, b"old")

    def full(self, data):
        self.touch()
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match="No space"):
        write_bytes_atomically(path, b"new")
    assert path.read_text() == "old"
    assert [each.name for each in tmp_path.iterdir()] == ["file"]


def test_drafts_of_killed_processes_are_removed_and_nothing_else(tmp_path):
    for name in ("a.json", ".a.json.123", ".a.json.backup", ".b.json.123", ".a.json"):
        (tmp_path / name).touch()
    remove_drafts(tmp_path / "a.json")
    assert sorted(path.name for path in tmp_path.iterdir()) == [".a.json", ".a.json.backup", ".b.json.123", "a.json"]
