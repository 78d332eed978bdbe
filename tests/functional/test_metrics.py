import math

import numpy as np
import pytest
import torch
from scipy import signal
from torch import Tensor
from torch.testing import assert_close

from ppt_rl.functional import MetricsConfig, begin_metrics, summarise_metrics, update_metrics
from ppt_rl.functional.metrics import MEMORY_SIZE, METRICS
from tests.sampling import normal

F64 = torch.float64
DT = 0.01
CONFIG = MetricsConfig(p_max=2.0, contact_force=0.05, cutoff=10.0)
B, A = signal.butter(2, CONFIG.cutoff, fs=1 / DT)
#: Half of a logarithmic bin: 256 bins over four decades.
HALF_BIN = 10 ** (0.5 * 4 / 256) - 1


def along_x(values: Tensor) -> Tensor:
    """Six columns: ``values``, and five of zeros."""
    return torch.nn.functional.pad(values.unsqueeze(-1), (0, 5))


def run(
    twist: Tensor, wrench: Tensor, power: Tensor | None = None, config: MetricsConfig = CONFIG, dt: float = DT
) -> Tensor:
    """Memory of an episode; time is the first dimension."""
    power = torch.zeros(*twist.shape[:-1], 1, dtype=twist.dtype) if power is None else power
    memory = begin_metrics(twist[0], wrench[0], config, dt=dt)
    for v, f, p in zip(twist, wrench, power, strict=True):
        memory = update_metrics(memory, v, f, p, config, dt=dt)
    return memory


def measure(twist: Tensor, wrench: Tensor, power: Tensor | None = None, **kwargs):
    return summarise_metrics(run(twist, wrench, power, **kwargs))


def filtered(x: np.ndarray) -> np.ndarray:
    """SciPy's low-pass filter, in its steady state at the first sample."""
    return signal.lfilter(B, A, x, axis=0, zi=signal.lfilter_zi(B, A)[:, None] * x[:1])[0]


def test_constant_velocity_has_no_jerk_from_the_first_step_on():
    twist = torch.ones(20, 6, dtype=F64) * torch.tensor([0.3, -0.2, 0.1, 1.0, 2.0, 3.0], dtype=F64)
    assert measure(twist, torch.zeros_like(twist))["jerk_rms"].item() < 1e-9


def test_jerk_equals_that_of_scipys_filtered_velocity_after_every_step():
    twist = normal(60, 6)
    velocity = filtered(twist[:, :3].numpy())
    padded = np.concatenate([twist[:1, :3], twist[:1, :3], velocity])
    jerk = np.diff(padded, 2, axis=0) / DT**2
    memory = begin_metrics(twist[0], torch.zeros(6, dtype=F64), CONFIG, dt=DT)
    for i, v in enumerate(twist, start=1):
        memory = update_metrics(memory, v, torch.zeros(6, dtype=F64), torch.zeros(1, dtype=F64), CONFIG, dt=DT)
        expected = math.sqrt((jerk[:i] ** 2).sum(-1).mean())
        assert summarise_metrics(memory)["jerk_rms"].item() == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("frequency", [1.0, 5.0, 20.0])
def test_jerk_of_a_sinusoid_is_its_amplitude_times_the_gains_of_filter_and_difference(frequency):
    amplitude, settle, steps = 0.2, 200, 400
    t = torch.arange(settle + steps, dtype=F64) * DT
    twist = along_x(amplitude * torch.sin(2 * math.pi * frequency * t))
    wrench = torch.zeros_like(twist)
    before, after = measure(twist[:settle], wrench[:settle]), measure(twist, wrench)
    # Mean square over the last steps, whole periods, when the filter has settled.
    square = (after["jerk_rms"] ** 2 * (settle + steps) - before["jerk_rms"] ** 2 * settle) / steps
    omega = 2 * math.pi * frequency * DT
    gain = abs(signal.freqz(B, A, worN=[omega])[1][0])
    difference = (2 - 2 * math.cos(omega)) / DT**2
    assert square.sqrt().item() == pytest.approx(amplitude * gain * difference / math.sqrt(2), rel=1e-6)


def test_jerk_of_a_slow_sinusoid_is_its_second_derivative():
    amplitude, frequency, steps = 0.2, 0.5, 800
    t = torch.arange(steps, dtype=F64) * DT
    twist = along_x(-amplitude * torch.cos(2 * math.pi * frequency * t))  # starts at rest
    expected = amplitude * (2 * math.pi * frequency) ** 2 / math.sqrt(2)
    assert measure(twist, torch.zeros_like(twist))["jerk_rms"].item() == pytest.approx(expected, rel=0.02)


def test_p95_of_a_force_ramp_is_within_the_bin():
    wrench = along_x(torch.linspace(0.0, 20.0, 1000, dtype=F64))
    lag = 20.0 / 1000 * 5  # the filter's delay is below five steps
    p95 = measure(torch.zeros_like(wrench), wrench)["wrench_p95"].item()
    assert 19.0 * (1 - HALF_BIN) - lag <= p95 <= 19.0 * (1 + HALF_BIN)


def test_p95_of_any_force_is_within_half_a_bin_of_the_quantile_of_the_filtered_norm():
    wrench = 5 * normal(500, 20, 6).cumsum(0) / 10
    p95 = measure(torch.zeros_like(wrench), wrench)["wrench_p95"].squeeze(-1)
    force = np.linalg.norm(filtered(wrench[..., :3].reshape(500, 60).numpy()).reshape(500, 20, 3), axis=-1)
    exact = np.quantile(force, 0.95, axis=0, method="inverted_cdf")
    assert_close(p95, torch.from_numpy(exact), rtol=HALF_BIN + 1e-6, atol=0.0)


@pytest.mark.parametrize("dtype", [torch.float32, F64])
@pytest.mark.parametrize("force", [0.02, 1.0, 7.3, 99.0])
def test_p95_of_a_constant_force_is_that_force_within_half_a_bin(force, dtype):
    wrench = along_x(torch.full((10,), force, dtype=dtype))
    p95 = measure(torch.zeros_like(wrench), wrench)["wrench_p95"].item()
    assert p95 == pytest.approx(force, rel=HALF_BIN + 1e-5)


def test_p95_of_no_force_is_zero():
    assert measure(torch.zeros(10, 6), torch.zeros(10, 6))["wrench_p95"].item() == 0.0


def test_p95_ignores_torques():
    wrench = torch.zeros(10, 6)
    wrench[:, 3:] = 50.0
    assert measure(torch.zeros(10, 6), wrench)["wrench_p95"].item() == 0.0


def test_overload_ratio_is_the_share_of_steps_whose_measured_power_exceeds_the_limit():
    twist = torch.tensor([1.0, 2.5, -3.0, 2.0, 0.0, -1.0, 4.0, 0.5]).unsqueeze(-1).expand(8, 6)
    wrench = along_x(torch.ones(8))
    assert measure(twist, wrench)["overload_ratio"].item() == pytest.approx(3 / 8)


def test_max_power_is_commanded_and_max_power_measured_is_that_of_wrench_and_twist():
    twist, wrench = normal(30, 6), normal(30, 6, seed=1)
    power = torch.tensor([0.5, -4.0, 3.0] * 10, dtype=F64).unsqueeze(-1)
    out = measure(twist, wrench, power)
    assert out["max_power"].item() == 4.0
    assert_close(out["max_power_measured"], (twist * wrench).sum(-1).abs().max().reshape(1))


@pytest.mark.parametrize("dt", [0.01, 0.002])
def test_work_is_the_absolute_commanded_power_summed_over_time(dt):
    power = torch.tensor([0.5, -4.0, 3.0, 0.0], dtype=F64).repeat(10).unsqueeze(-1)
    still = torch.zeros(40, 6, dtype=F64)
    out = measure(still, still, power, dt=dt)
    assert out["work"].item() == pytest.approx(10 * (0.5 + 4.0 + 3.0) * dt)


def test_braking_is_work_so_a_sinusoidal_power_does_the_work_of_its_absolute_value():
    t = torch.arange(1000, dtype=F64) * DT  # ten periods in ten seconds
    power = (1.5 * torch.sin(2 * math.pi * t)).unsqueeze(-1)
    still = torch.zeros(1000, 6, dtype=F64)
    assert measure(still, still, power)["work"].item() == pytest.approx(10 * 1.5 * 2 / math.pi, rel=1e-3)


def test_work_grows_with_every_step_and_is_that_of_the_command_not_of_the_wrist():
    twist, wrench = normal(30, 6), normal(30, 6, seed=1)
    power = normal(30, 1, seed=2)
    memory = begin_metrics(twist[0], wrench[0], CONFIG, dt=DT)
    for i in range(30):
        memory = update_metrics(memory, twist[i], wrench[i], power[i], CONFIG, dt=DT)
        expected = DT * power[: i + 1].abs().sum()
        assert summarise_metrics(memory)["work"].item() == pytest.approx(expected.item())


def contact(force: list[float]) -> float:
    # A filter whose cutoff is just below half the control rate follows these steps within the step.
    wrench = along_x(torch.tensor(force, dtype=F64))
    return measure(torch.zeros_like(wrench), wrench, config=MetricsConfig(cutoff=49.9))["contact_continuity"].item()


def test_uninterrupted_contact_has_continuity_one_whenever_it_happens():
    assert contact([5.0] * 10) == 1.0
    assert contact([0.0] * 5 + [5.0] * 10) == 1.0


def test_contact_for_half_of_the_time_between_first_and_last_touch_has_continuity_one_half():
    assert contact([0.0] * 3 + ([5.0] * 4 + [0.0] * 8 + [5.0] * 4) + [0.0] * 3) == pytest.approx(0.5)


def test_no_contact_has_continuity_zero():
    assert contact([0.0] * 10) == 0.0
    assert contact([0.049] * 10) == 0.0


def test_one_touch_has_continuity_one():
    assert contact([0.0, 0.0, 5.0, 0.0, 0.0]) == 1.0


def test_the_quantities_of_the_summary_do_not_share_memory():
    # Each input drives its own quantities and no others.
    steps, still = 20, torch.zeros(20, 6, dtype=F64)
    shake, push = along_x(torch.arange(20, dtype=F64) % 2), along_x(torch.full((20,), 3.0, dtype=F64))
    turn = torch.nn.functional.pad(torch.full((steps, 1), 3.0, dtype=F64), (3, 2))  # steady, about an axis
    power = torch.full((steps, 1), 0.5, dtype=F64)
    driven = {
        ("max_power", "work"): measure(still, still, power),
        ("jerk_rms",): measure(shake, still),
        ("wrench_p95", "contact_continuity"): measure(still, push),
        ("max_power_measured", "overload_ratio"): measure(turn, turn),
    }
    for names, summary in driven.items():
        assert {name for name, value in summary.items() if value.item() > 1e-9} == set(names)


@pytest.mark.parametrize("batch", [(3,), (2, 3)])
def test_batched_rows_equal_single_episodes(batch):
    twist, wrench, power = normal(40, *batch, 6), 3 * normal(40, *batch, 6, seed=1), normal(40, *batch, 1, seed=2)
    memory = run(twist, wrench, power)
    assert memory.shape == (*batch, MEMORY_SIZE)
    rows = [x.reshape(40, -1, x.shape[-1]).unbind(1) for x in (twist, wrench, power)]
    singles = [run(*row) for row in zip(*rows, strict=True)]
    assert_close(memory.reshape(-1, MEMORY_SIZE), torch.stack(singles))
    for value in summarise_metrics(memory).values():
        assert value.shape == (*batch, 1)


def test_rows_that_restart_later_equal_separate_episodes():
    twist, wrench, power = normal(40, 2, 6), 3 * normal(40, 2, 6, seed=1), normal(40, 2, 1, seed=2)
    memory = begin_metrics(twist[0], wrench[0], CONFIG, dt=DT)
    for i in range(40):
        if i == 15:
            restart = torch.tensor([[False], [True]])
            memory = torch.where(restart, begin_metrics(twist[i], wrench[i], CONFIG, dt=DT), memory)
        memory = update_metrics(memory, twist[i], wrench[i], power[i], CONFIG, dt=DT)
    assert_close(memory[0], run(twist[:, 0], wrench[:, 0], power[:, 0]))
    assert_close(memory[1], run(twist[15:, 1], wrench[15:, 1], power[15:, 1]))


def test_an_update_does_not_change_the_old_memory():
    memory = begin_metrics(torch.ones(6), torch.ones(6), CONFIG, dt=DT)
    before = memory.clone()
    update_metrics(memory, torch.zeros(6), torch.zeros(6), torch.ones(1), CONFIG, dt=DT)
    assert torch.equal(memory, before)


def test_the_summary_before_any_step_is_zero():
    summary = summarise_metrics(begin_metrics(torch.ones(6), torch.ones(6), CONFIG, dt=DT))
    assert tuple(summary) == METRICS
    assert all(value.item() == 0.0 for value in summary.values())


@pytest.mark.parametrize("name", ["p_max", "contact_force", "cutoff"])
@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan])
def test_constants_that_are_not_positive_are_refused(name, bad):
    with pytest.raises(ValueError, match=f"{name} is {bad}; expected a finite number above 0"):
        MetricsConfig(**{name: bad})


@pytest.mark.parametrize("dt", [0.01, 0.002])
def test_a_cutoff_at_half_the_control_rate_is_refused(dt):
    config, still = MetricsConfig(cutoff=0.5 / dt), torch.zeros(6)
    with pytest.raises(ValueError, match=rf"expected a frequency below half the control rate, {0.5 / dt} Hz"):
        begin_metrics(still, still, config, dt=dt)
