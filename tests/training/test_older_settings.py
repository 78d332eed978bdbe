from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import pytest

from ppt_rl.training import CheckpointMismatch, RunConfig, as_json, from_json
from ppt_rl.training.ppo import PPOConfig
from ppt_rl.training.run import _check_same_run, _completed


@dataclass(frozen=True)
class Config(RunConfig):
    masses: tuple[float, ...] = ()
    gain: float = 2.0


@dataclass(frozen=True)
class Demanding:
    needed: float
    ppo: PPOConfig = field(default_factory=PPOConfig)


def test_settings_survive_their_json_form():
    config = Config(masses=(0.1, 0.2), gain=3.0, ppo=PPOConfig(epochs=3))
    assert from_json(Config, as_json(config)) == config


def test_a_field_that_older_settings_lack_takes_its_default():
    older = as_json(Config(gain=3.0, ppo=PPOConfig(epochs=3)))
    del older["masses"], older["ppo"]["clip"]
    assert from_json(Config, older) == Config(gain=3.0, ppo=PPOConfig(epochs=3))


def test_a_missing_field_without_a_default_and_an_unknown_one_are_refused_by_name():
    with pytest.raises(ValueError, match=r"settings of Demanding have no \['needed'\] and unknown \['tempo'\]"):
        from_json(Demanding, {"tempo": 1.0})
    assert from_json(Demanding, {"needed": 1.0}) == Demanding(1.0)


def test_a_run_from_before_an_option_was_there_can_be_resumed_unless_the_option_is_set():
    older = as_json(Config())
    del older["masses"], older["ppo"]["clip"]
    completed = _completed(older, as_json(Config()))
    _check_same_run(completed, as_json(Config()), Path("run"))
    with pytest.raises(CheckpointMismatch, match="other values of masses"):
        _check_same_run(completed, as_json(Config(masses=(0.1,))), Path("run"))
