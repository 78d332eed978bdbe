from __future__ import annotations

import step_rate


def test_the_benchmark_reports_rates_ratios_and_memory():
    result = step_rate.measure(step_rate.Config(num_envs=2, threads=1, repeats=1, seconds=0.1))
    assert {"ratio_base", "ratio_chain", "ratio_collector", "rate_raw", "memory_per_env_mib"} <= set(result)
    assert all(value >= 0 for value in result.values())


def test_the_environment_replays_the_physics_of_the_chain(monkeypatch):
    import torch

    from ppt_rl.envs.physics import ThreadedPhysics

    states = []
    step = ThreadedPhysics.step

    def spy(self, control, rows=None):
        result = step(self, control, rows)
        states.append(torch.from_numpy(self._state.copy()))
        return result

    monkeypatch.setattr(ThreadedPhysics, "step", spy)
    step_rate.measure(step_rate.Config(num_envs=2, threads=1, repeats=1, seconds=0.1))
    base, chain = states[29], states[39]
    torch.testing.assert_close(base, chain, rtol=0, atol=1e-5)
