from __future__ import annotations

import pytest
import torch

from ppt_rl.envs import ArmEnv, EngineConfig


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"num_threads": 0}, "num_threads is 0; expected at least 1, or None"),
        ({"physics_dt": 0.0}, "physics_dt is 0.0; expected a finite number above 0 s"),
        ({"physics_dt": float("nan")}, "physics_dt is nan; expected a finite number above 0 s"),
    ],
)
def test_impossible_options_of_the_physics_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        EngineConfig(**options)


def test_an_environment_steps_its_physics_as_the_options_say():
    options = EngineConfig(physics_dt=0.005, num_threads=1, audit=True, name="threads")
    env = ArmEnv(2, engine=options, seed=0)
    assert env.engine_config is options
    assert (env.substeps, env.engine.num_threads, env.engine.models[0].opt.timestep) == (2, 1, 0.005)
    assert "audit" in env.reset().keys()
    assert "audit" not in ArmEnv(2, seed=0).reset().keys()


def test_the_environment_variable_chooses_the_engine_where_no_option_does(monkeypatch):
    cpu = torch.device("cpu")
    monkeypatch.delenv("PPT_RL_ENGINE", raising=False)
    assert EngineConfig().on(cpu) == "threads"
    monkeypatch.setenv("PPT_RL_ENGINE", "warp")
    assert EngineConfig().on(cpu) == "warp"
    assert EngineConfig(name="threads").on(cpu) == "threads"
    monkeypatch.setenv("PPT_RL_ENGINE", "auto")
    assert EngineConfig().on(cpu) == "threads"
    monkeypatch.setenv("PPT_RL_ENGINE", "wrap")
    with pytest.raises(ValueError, match=r"PPT_RL_ENGINE is 'wrap'; expected one of \['auto', 'threads', 'warp'\]"):
        EngineConfig().on(cpu)
