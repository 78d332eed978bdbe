from __future__ import annotations

import errno
import importlib.util
import json
import os
import time
from pathlib import Path

import numpy as np
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from ppt_rl.training.extras import MissingPackage
from ppt_rl.training.logs import (
    RunLogs,
    read_scalar,
    remove_drafts,
    saved_config,
    write_bytes_atomically,
)
from tests.training.tiny import tiny, train


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

    def full(number):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        write_bytes_atomically(path, b"new")
    assert path.read_text() == "old"
    assert [each.name for each in tmp_path.iterdir()] == ["file"]


def test_the_content_is_on_the_disk_before_the_name_is(tmp_path, monkeypatch):
    done, sync, replace = [], os.fsync, Path.replace
    monkeypatch.setattr(os, "fsync", lambda number: (done.append("content"), sync(number)))
    monkeypatch.setattr(Path, "replace", lambda draft, path: (done.append("name"), replace(draft, path))[1])
    write_bytes_atomically(tmp_path / "file", b"new")
    assert done == ["content", "name"]
    assert (tmp_path / "file").read_bytes() == b"new"


def test_drafts_of_killed_processes_are_removed_and_nothing_else(tmp_path):
    for name in ("a.json", ".a.json.123", ".a.json.backup", ".b.json.123", ".a.json"):
        (tmp_path / name).touch()
    remove_drafts(tmp_path / "a.json")
    assert sorted(path.name for path in tmp_path.iterdir()) == [".a.json", ".a.json.backup", ".b.json.123", "a.json"]


# -- loggers -----------------------------------------------------------------------------------------------------------


def installed(name):
    missing = importlib.util.find_spec(name) is None
    return pytest.mark.skipif(missing, reason=f"{name}, of ppt_rl[{name}], is not installed")


def with_logger(run_dir: Path, name: str, *at: int, last_step: int = 0) -> None:
    logs = RunLogs(run_dir, last_step, loggers=(name,), options={"p_max": 2.0, "ppo": {"epochs": 1}})
    for step in at:
        logs.write({"reward": step / 3, "success": 0.5}, step)
    logs.flush()
    logs.close()


def in_mlflow(run_dir: Path) -> list[tuple[dict[str, list[tuple[int, float]]], dict[str, str]]]:
    """History of every metric, and the parameters, of each run that is not deleted."""
    import mlflow

    client = mlflow.MlflowClient(tracking_uri=f"sqlite:///{run_dir.resolve()}/logs/mlflow.db")
    experiment = client.get_experiment_by_name("ppt_rl")
    found = []
    for run in client.search_runs([experiment.experiment_id]):
        names = run.data.metrics
        history = {
            name: [(m.step, m.value) for m in client.get_metric_history(run.info.run_id, name)] for name in names
        }
        found.append((history, run.data.params))
    return found


def records(path: Path) -> list[bytes]:
    """Records of a file of Weights & Biases: LevelDB's log format after a header of seven bytes."""
    data, place, found, part = path.read_bytes(), 7, [], b""
    while place + 7 <= len(data):
        if 32_768 - place % 32_768 < 7:  # a block's rest that holds no header
            place += 32_768 - place % 32_768
            continue
        length, kind = int.from_bytes(data[place + 4 : place + 6], "little"), data[place + 6]
        part += data[place + 7 : place + 7 + length]
        place += 7 + length
        if kind in (1, 4):  # a whole record, or the end of one
            found.append(part)
            part = b""
    return found


def in_wandb(run_dir: Path) -> list[list[dict[str, float]]]:
    """Rows of the history of each offline run."""
    from wandb.proto import wandb_internal_pb2

    found = []
    for path in sorted((run_dir / "logs" / "wandb").glob("offline-run-*/*.wandb")):
        kinds: list[str] = []
        for _ in range(200):  # its own process may write a moment longer than the run
            read = [wandb_internal_pb2.Record.FromString(data) for data in records(path)]
            kinds = [record.WhichOneof("record_type") for record in read]
            if "exit" in kinds:
                break
            time.sleep(0.1)
        rows = [record.history.item for record, kind in zip(read, kinds, strict=True) if kind == "history"]
        found.append([{i.key or "/".join(i.nested_key): json.loads(i.value_json) for i in row} for row in rows])
    return found


@installed("mlflow")
def test_mlflow_holds_each_step_once_in_one_run_after_a_run_went_on(tmp_path):
    with_logger(tmp_path, "mlflow", 10, 20, 30)
    with_logger(tmp_path, "mlflow", 30, 40, last_step=20)
    ((history, parameters),) = in_mlflow(tmp_path)
    assert [step for step, _ in history["reward"]] == [10, 20, 30, 40]
    assert [value for _, value in history["reward"]] == pytest.approx([10 / 3, 20 / 3, 10, 40 / 3])
    assert parameters == {"p_max": "2.0", "ppo": "{'epochs': 1}"}
    assert read_scalar(tmp_path, "reward")[0].tolist() == [10, 20, 30, 40]


@installed("wandb")
def test_wandb_holds_each_step_once_in_one_offline_run_after_a_run_went_on(tmp_path):
    with_logger(tmp_path, "wandb", 10, 20, 30)
    with_logger(tmp_path, "wandb", 30, 40, last_step=20)
    (rows,) = in_wandb(tmp_path)
    assert [row["_step"] for row in rows] == [10, 20, 30, 40]
    assert [row["reward"] for row in rows] == pytest.approx([10 / 3, 20 / 3, 10, 40 / 3])


def test_without_tensorboard_there_are_no_events_and_csv_is_always_there(tmp_path):
    with_logger(tmp_path, "csv", 10)
    assert not (tmp_path / "logs" / "tensorboard").exists()
    with_logger(tmp_path, "tensorboard", 20, last_step=10)
    assert read_scalar(tmp_path, "reward")[0].tolist() == [10, 20]
    assert steps(tmp_path)["reward"] == [10, 20]


@pytest.mark.parametrize("loggers", [("paper",), ("csv", "csv"), "csv", ("tensorboard", 3)])
def test_unknown_loggers_are_refused_with_the_options(tmp_path, loggers):
    with pytest.raises(ValueError, match=r"logger is .*; expected some of \['csv', 'tensorboard', 'wandb', 'mlflow'\]"):
        tiny(tmp_path, logger=loggers)
    with pytest.raises(ValueError, match="logger is"):
        RunLogs(tmp_path, loggers=loggers)


@pytest.mark.parametrize("name", ["wandb", "mlflow"])
def test_a_logger_whose_package_is_missing_is_refused_before_anything_is_written(tmp_path, monkeypatch, name):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(
        MissingPackage, match=rf"--logger {name} needs the package {name}.*pip install 'ppt_rl\[{name}\]'"
    ):
        tiny(tmp_path, logger=("csv", name))
    with pytest.raises(MissingPackage):
        RunLogs(tmp_path, loggers=(name,))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", [pytest.param(name, marks=installed(name)) for name in ("wandb", "mlflow")])
def test_a_training_logs_what_its_csv_files_hold(tmp_path, name):
    train(tmp_path, 2, logger=("csv", name))
    expected = read_scalar(tmp_path, "reward")
    if name == "mlflow":
        ((history, _),) = in_mlflow(tmp_path)
        found = np.asarray(history["reward"]).T
    else:
        (rows,) = in_wandb(tmp_path)
        found = np.asarray([(row["_step"], row["reward"]) for row in rows if "reward" in row]).T
    np.testing.assert_allclose(found, expected)


def test_a_run_may_go_on_with_other_loggers(tmp_path):
    train(tmp_path, 1, logger=("csv",))
    train(tmp_path, 2, resume=True)
    assert steps(tmp_path)["reward"] == read_scalar(tmp_path, "reward")[0].tolist()
