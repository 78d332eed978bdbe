from __future__ import annotations

import kills
import pytest


def kill(number, lives, capsys):
    """Kill trainings that are forked from this process; the report."""
    with pytest.raises(SystemExit) as end:
        kills.main(kills.Config(number, lives))
    said = capsys.readouterr().out
    assert end.value.code == 0, said
    return said


def test_four_killed_trainings_go_on_one_of_them_from_its_first_write(capsys):
    expected = "2 inside the write of a checkpoint (1 in the first of a run), 2 at other times"
    assert expected in kill(4, 4, capsys)


@pytest.mark.slow
def test_a_hundred_killed_trainings_go_on(capsys):
    expected = "50 inside the write of a checkpoint (10 in the first of a run), 50 at other times"
    assert expected in kill(100, 10, capsys)


def test_a_loss_of_more_than_one_interval_or_a_fault_fails(capsys):
    for result, status in (
        (kills.Result(2, 1, [0, 1]), 0),
        (kills.Result(2, 1, [0, 2]), 1),
        (kills.Result(2, 1, [0, 1], ["reward has the steps [20, 20]"]), 1),
    ):
        with pytest.raises(SystemExit) as end:
            kills.report(kills.Config(), result, 1.0)
        assert end.value.code == status
    assert "reward has the steps [20, 20]" in capsys.readouterr().out


def test_steps_that_are_missing_or_twice_and_leftovers_are_found(tmp_path):
    logs = kills.RunLogs(tmp_path)
    for step in (20, 40, 60):
        logs.write({"reward": 0.5}, step)
    logs.close()
    assert kills.found_faults(tmp_path, 60) == []
    assert len(kills.found_faults(tmp_path, 80)) == 1
    twice = kills.RunLogs(tmp_path, last_step=60)
    twice.write({"reward": 0.5}, 60)
    twice.close()
    (tmp_path / ".config.json.12").touch()
    assert len(kills.found_faults(tmp_path, 60)) == 2
