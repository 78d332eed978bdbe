import pytest

from benchmarks.time_to_success import time_to


def write(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


@pytest.mark.parametrize("kept", [False, True])
def test_the_first_validation_that_is_good_enough_counts(tmp_path, kept):
    if kept:
        write(tmp_path / "validation.csv", "control_steps,success\n0,0.3\n200,0.9\n400,0.8\n600,0.96\n")
        write(tmp_path / "curves.csv", "control_steps,seconds\n100,5\n200,10\n600,30\n")
    else:
        scalars = tmp_path / "logs/csv/scalars"
        write(scalars / "validation_success.csv", "0,0.3\n200,0.9\n400,0.8\n600,0.96\n")
        write(scalars / "seconds.csv", "100,5\n200,10\n600,30\n")
    assert time_to(tmp_path, 0.9) == {"seconds": 10.0, "control_steps": 200.0, "best": 0.96, "rate": 20.0}
    assert time_to(tmp_path, 0.95)["seconds"] == 30.0
    assert time_to(tmp_path, 0.99)["seconds"] is None


def test_a_run_without_validations_is_refused(tmp_path):
    with pytest.raises(ValueError, match="has no validation_success; expected a training run with --validate-every"):
        time_to(tmp_path, 0.9)
