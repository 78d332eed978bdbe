from __future__ import annotations

import os
import signal
import time

import pytest

from ppt_rl.training import CheckpointMismatch, TrainingDiverged, find_checkpoint, progress
from ppt_rl.training.checkpoint import all_checkpoints, step_of
from ppt_rl.training.directory import only_process_in, remove_leftovers, set_aside_newer
from ppt_rl.training.logs import read_scalar
from tests.training.tiny import BATCH, forked, tiny, train, write

HEX = "0123456789abcdef" * 2


def steps(run_dir):
    return read_scalar(run_dir, "reward")[0].tolist()


# -- one process -------------------------------------------------------------------------------------------------------


def test_a_second_training_in_a_directory_is_refused_with_one_line(tmp_path):
    with only_process_in(tmp_path), pytest.raises(CheckpointMismatch) as caught:
        train(tmp_path)
    message = str(caught.value)
    assert f"{tmp_path} is in use by another process; expected one process a run" in message
    assert "\n" not in message
    assert not (tmp_path / "checkpoints").exists()
    train(tmp_path, 1)  # and after it, it is free


def test_the_lock_dies_with_its_process(tmp_path):
    def hold():
        with only_process_in(tmp_path):
            (tmp_path / "held").touch()
            time.sleep(60)

    child = forked(hold, tmp_path / "output")
    while not (tmp_path / "held").exists():
        time.sleep(0.01)
    with pytest.raises(CheckpointMismatch, match="in use"), only_process_in(tmp_path):
        pass
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    with only_process_in(tmp_path):
        pass


def test_the_lock_is_given_back_where_the_training_fails(tmp_path, monkeypatch):
    monkeypatch.setattr(progress.Progress, "learn", lambda self, batch: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        train(tmp_path)
    with only_process_in(tmp_path):
        pass


# -- leftovers ---------------------------------------------------------------------------------------------------------


def test_what_a_killed_write_left_is_removed(tmp_path):
    write(tmp_path, 10)
    folder, name = tmp_path / "checkpoints", "checkpoint-000000000020.torchrl"
    (folder / f".{name}.stage-{HEX}" / "components").mkdir(parents=True)
    for state in ("archive", "delete"):
        (folder / f".{name}.{state}-{HEX}").touch()
    (folder / f".checkpoint-000000000010.torchrl.backup-{HEX}").touch()  # its new version is there
    (folder / ".mine").touch()
    (tmp_path / ".config.json.77").touch()
    remove_leftovers(tmp_path)
    assert sorted(path.name for path in folder.iterdir()) == [".mine", "checkpoint-000000000010.torchrl"]
    assert not (tmp_path / ".config.json.77").exists()


def test_a_checkpoint_that_was_just_being_replaced_comes_back(tmp_path):
    (path,) = write(tmp_path, 10)
    path.replace(path.with_name(f".{path.name}.backup-{HEX}"))
    assert all_checkpoints(tmp_path) == []
    remove_leftovers(tmp_path)
    assert find_checkpoint(tmp_path) == path


# -- beginning and going on --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("resume", [False, True])
def test_a_run_killed_in_its_first_write_starts_afresh_with_and_without_resume(tmp_path, resume, capfd):
    def die():
        progress.save_checkpoint = lambda run_dir, *args, **kwargs: (
            (run_dir / "checkpoints" / f".checkpoint-000000000020.torchrl.stage-{HEX}").mkdir(parents=True),
            os.kill(os.getpid(), signal.SIGKILL),
        )
        train(tmp_path)

    os.waitpid(forked(die, tmp_path / "output"), 0)
    assert steps(tmp_path) == [BATCH]
    train(tmp_path, 2, resume=resume)
    assert f"{tmp_path} holds no checkpoint yet: the run starts afresh." in capfd.readouterr().err.splitlines()
    assert steps(tmp_path) == [BATCH, 2 * BATCH]
    assert len(list((tmp_path / "checkpoints").iterdir())) == 2


def test_a_run_that_begins_in_an_empty_directory_says_nothing_of_that(tmp_path, capfd):
    train(tmp_path, 1)
    assert "afresh" not in capfd.readouterr().err


def test_a_run_with_damaged_checkpoints_only_is_not_begun_again(tmp_path):
    train(tmp_path, 1)
    find_checkpoint(tmp_path).write_bytes(b"")
    for resume, message in ((False, "holds a run already"), (True, "holds 1 checkpoints and none can be read")):
        with pytest.raises(CheckpointMismatch, match=message):
            train(tmp_path, 2, resume=resume)
    assert steps(tmp_path) == [BATCH]


def test_a_run_goes_on_from_the_newest_checkpoint_that_can_be_read(tmp_path, capfd):
    train(tmp_path, 3)
    find_checkpoint(tmp_path).write_bytes(b"damaged")
    with pytest.warns(UserWarning, match="checkpoint-000000000040.torchrl is taken in its place"):
        train(tmp_path, 4, resume=True)
    assert steps(tmp_path) == [BATCH, 2 * BATCH, 3 * BATCH, 4 * BATCH]
    assert (tmp_path / "checkpoints" / "superseded" / "checkpoint-000000000060.torchrl").read_bytes() == b"damaged"
    assert "checkpoint-000000000060.torchrl moved to" in capfd.readouterr().err


def test_a_run_goes_on_from_the_checkpoint_that_is_named(tmp_path):
    train(tmp_path, 3)
    first = all_checkpoints(tmp_path)[-1]
    assert step_of(first) < 3 * BATCH
    seconds = read_scalar(tmp_path, "seconds")[1]
    train(tmp_path, 4, resume_from=first)
    assert steps(tmp_path) == [BATCH, 2 * BATCH, 3 * BATCH, 4 * BATCH]
    kept = step_of(first) // BATCH
    again = read_scalar(tmp_path, "seconds")[1]
    assert (again[:kept] == seconds[:kept]).all()
    assert (again[kept:3] != seconds[kept:]).all()


def test_a_checkpoint_of_another_run_goes_on_in_a_directory_of_its_own_only(tmp_path):
    there = train(tmp_path / "a", 2)
    path = train(tmp_path / "b", 3, resume_from=there)
    assert path.parent.parent == tmp_path / "b"
    assert steps(tmp_path / "b") == [3 * BATCH]
    assert len(all_checkpoints(tmp_path / "a")) == 2
    with pytest.raises(CheckpointMismatch, match=r"--resume-from is .*holds another run; expected one of its own"):
        train(tmp_path / "b", 4, resume_from=there)


def test_a_finished_run_is_resumed_without_writing_its_checkpoint_again(tmp_path):
    path = train(tmp_path, 2)
    written = path.stat().st_ino, path.stat().st_mtime_ns
    assert train(tmp_path, 2, resume=True) == path
    assert (path.stat().st_ino, path.stat().st_mtime_ns) == written


def test_newer_checkpoints_are_set_aside_and_not_lost(tmp_path):
    first, second = write(tmp_path, 10, 20)
    set_aside_newer(tmp_path, first)
    assert all_checkpoints(tmp_path) == [first]
    assert (tmp_path / "checkpoints" / "superseded" / second.name).exists()


# -- updates that are not finite ---------------------------------------------------------------------------------------


def poison(monkeypatch, batch, **changes):
    """Let the networks become NaN after the update of a batch."""
    learn = progress.Learner.update

    def update(self, data):
        scalars = learn(self, data)
        self.updates = getattr(self, "updates", 0) + 1
        if self.updates == batch:
            next(self.actor.parameters()).data.fill_(float("nan"))
        return scalars | (changes if self.updates == batch else {})

    monkeypatch.setattr(progress.Learner, "update", update)


def test_an_update_that_is_not_finite_leaves_the_last_checkpoint_and_the_run_goes_on_from_it(tmp_path, monkeypatch):
    poison(monkeypatch, 3)
    with pytest.raises(TrainingDiverged) as caught:
        train(tmp_path, 5)
    message = str(caught.value)
    assert "the update after 40 control steps is not finite: actor." in message
    assert f"--resume goes on from {find_checkpoint(tmp_path)}" in message
    assert "lower --ppo.learning-rate (now 0.0003)" in message
    assert "\n" not in message
    assert step_of(find_checkpoint(tmp_path)) == 2 * BATCH
    assert steps(tmp_path) == [BATCH, 2 * BATCH]
    monkeypatch.undo()
    train(tmp_path, 4, resume=True)
    assert steps(tmp_path) == [BATCH, 2 * BATCH, 3 * BATCH, 4 * BATCH]


def test_a_first_update_that_is_not_finite_writes_no_checkpoint(tmp_path, monkeypatch):
    poison(monkeypatch, 1)
    with pytest.raises(TrainingDiverged, match="--resume starts afresh, since there is no checkpoint"):
        train(tmp_path)
    assert all_checkpoints(tmp_path) == []


def test_losses_that_are_not_finite_end_the_run_too(tmp_path, monkeypatch):
    learn = progress.Learner.update
    monkeypatch.setattr(progress.Learner, "update", lambda self, data: learn(self, data) | {"kl": float("inf")})
    with pytest.raises(TrainingDiverged, match=r"update\.kl is not finite"):
        train(tmp_path)
    assert all_checkpoints(tmp_path) == []


def test_an_error_within_a_batch_writes_no_half_updated_state(tmp_path, monkeypatch):
    norm, calls = progress.update_input_norm, []

    def fail(module, batch):
        calls.append(module)
        if len(calls) == 5:  # two networks a batch: the third batch
            raise RuntimeError("no more")
        norm(module, batch)

    monkeypatch.setattr(progress, "update_input_norm", fail)
    with pytest.raises(RuntimeError, match="no more"):
        train(tmp_path, 5)
    assert step_of(find_checkpoint(tmp_path)) == 2 * BATCH


def test_a_batch_that_no_machine_holds_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"num_envs \* batch_steps is 9\.8304e\+08; expected at most 1e\+07"):
        tiny(tmp_path, num_envs=16_384, duration=600.0)
