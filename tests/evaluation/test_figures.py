from __future__ import annotations

import numpy as np
import pytest

from ppt_rl.evaluation.figures import moving_average, plot_training
from ppt_rl.training.logs import RunLogs, read_scalar


def test_a_moving_average_equals_the_mean_over_its_window():
    values = np.random.default_rng(0).normal(size=20)
    expected = [values[max(0, i - 4) : i + 1].mean() for i in range(20)]
    np.testing.assert_allclose(moving_average(values, 5), expected)


def test_a_window_below_one_is_refused():
    with pytest.raises(ValueError, match="expected a whole number of at least 1"):
        moving_average(np.zeros(3), 0)


def test_training_curves_are_drawn_from_the_logs(tmp_path):
    logs = RunLogs(tmp_path)
    for step in range(1, 6):
        logs.write({"success": 0.1 * step, "max_power": 2.0 - 0.1 * step}, step * 100)
    plot_training(tmp_path, tmp_path / "training.png", p_max=2.0)
    assert (tmp_path / "training.png").stat().st_size > 10_000
    logs.write({"validation_success": 0.5, "validation_max_power": 1.5}, 200)
    logs.close()
    plot_training(tmp_path, tmp_path / "validated.png", p_max=2.0)
    assert (tmp_path / "validated.png").read_bytes() != (tmp_path / "training.png").read_bytes()


def test_logs_after_the_checkpoint_are_dropped_when_a_run_goes_on(tmp_path):
    logs = RunLogs(tmp_path)
    for step in (100, 200, 300):
        logs.write({"success": 0.5}, step)
    logs.close()
    RunLogs(tmp_path, last_step=200).write({"success": 0.7}, 300)
    assert read_scalar(tmp_path, "success")[0].tolist() == [100, 200, 300]
    assert read_scalar(tmp_path, "success")[1].tolist() == [0.5, 0.5, 0.7]
