from __future__ import annotations

import json
import math
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import ClassVar

import pytest

from ppt_rl.envs import PushEnv
from ppt_rl.evaluation import find_recipe, shipped_recipes
from ppt_rl.functional.checks import Bounds
from ppt_rl.training import PPOConfig, RunConfig, as_json, from_json, preset_options, with_settings

#: Numbers that let a training hang or exhaust the memory.
ABSURD = {
    "num_envs": 10**9, "num_threads": 10**6, "torch_threads": 10**6, "update_threads": 10**6,
    "batch_steps": 10**9, "num_basis": 10**9, "replan_steps": 10**9, "duration": 1e9,
    "training_duration": 1e9, "physics_dt": 1e-9, "control_dt": 1e-9,
    "promp_duration": 1e9, "seed": 2**40,
}  # fmt: skip
#: Numbers of which None takes the default of the goal, or of the cost.
_OF_THE_GOAL = ("cost_limit", "duration", "e_max", "energy_penalty", "max_velocity")
ABSURD_PPO = {"total_control_steps": 10**15, "epochs": 10**9, "minibatches": 10**9, "checkpoint_every": 10**12}


def numbers(config):
    """Names of the numeric fields."""
    return [f.name for f in fields(config) if type(getattr(config, f.name)) in (int, float)]


@pytest.mark.parametrize("variant", shipped_recipes())
def test_the_defaults_of_a_recipe_are_within_their_bounds_and_every_number_has_some(variant):
    config = find_recipe(variant).config()
    known = {name for kind in type(config).__mro__ for name in vars(kind).get("bounds", {})}
    assert set(numbers(config)) <= known
    assert set(numbers(config.ppo)) == set(PPOConfig.bounds)


@pytest.mark.parametrize("variant", shipped_recipes())
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, -1, -0.5, "many", None, True])
def test_no_number_of_a_recipe_may_be_nan_infinite_negative_or_no_number(variant, bad):
    config = find_recipe(variant).config
    for name in numbers(config()):
        if (name == "counter_turn" and isinstance(bad, float | int)) or (name in _OF_THE_GOAL and bad is None):
            continue  # it may be negative; None takes the default of the goal or of the cost
        with pytest.raises(ValueError, match=rf"^{name} is .*; expected a (whole )?number from "):
            config(**{name: bad})


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, -1, -0.5, "many", None, True])
@pytest.mark.parametrize("name", PPOConfig.bounds)
def test_no_setting_of_ppo_may_be_nan_infinite_negative_or_no_number(name, bad):
    with pytest.raises(ValueError, match=rf"^{name} is .*; expected a (whole )?number from "):
        PPOConfig(**{name: bad})


@pytest.mark.parametrize("variant", shipped_recipes())
def test_numbers_that_no_machine_could_hold_or_finish_are_refused(variant):
    config = find_recipe(variant).config
    for name in ABSURD.keys() & set(numbers(config())):
        with pytest.raises(ValueError, match=rf"^{name} is .*; expected a (whole )?number from "):
            config(**{name: ABSURD[name]})


@pytest.mark.parametrize(("name", "value"), ABSURD_PPO.items())
def test_a_setting_of_ppo_that_would_never_end_is_refused(name, value):
    with pytest.raises(ValueError, match=rf"^{name} is {value}; expected a whole number from "):
        PPOConfig(**{name: value})


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"duration": 600.0, "control_dt": 1e-3}, r"duration / control_dt is 600000; expected at most 60000: lower"),
        ({"control_dt": 1.0, "physics_dt": 1e-5}, r"control_dt / physics_dt is 100000; expected at most 1000: raise"),
        ({"num_envs": 16_384, "duration": 300.0}, r"num_envs \* duration / control_dt is 4.*e\+08; expected at most"),
    ],
)
def test_numbers_that_are_absurd_together_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        find_recipe("ppt_push").config(**settings)


def test_the_message_names_the_unit():
    with pytest.raises(ValueError, match=r"^physics_dt is 1e-09; expected a number from 1e-05 to 0\.1 s\.$"):
        find_recipe("ppt_push").config(physics_dt=1e-9)


def test_a_whole_number_is_asked_for_where_a_count_is_meant():
    with pytest.raises(ValueError, match=r"^num_envs is 2\.5; expected a whole number from 1 to 16384\.$"):
        RunConfig(num_envs=2.5)


@dataclass(frozen=True)
class Mine(RunConfig):
    """Options of somebody's recipe.

    Attributes:
        gain: a number with bounds.
        offset: a number without.
        lengths: several.
    """

    gain: float = 1.0
    offset: float = 0.0
    lengths: tuple[float, ...] = (1.0,)

    bounds: ClassVar[dict[str, Bounds]] = {
        "gain": Bounds(0.5, 2.0, "m"),
        "num_envs": Bounds(1, 4),
        "lengths": Bounds(0.0, 9.0),
    }
    num_envs: int = 2


def test_a_recipe_of_ones_own_adds_bounds_and_narrows_those_it_inherits():
    Mine(gain=2.0, num_envs=4, offset=-1e9)
    for bad in ({"gain": 2.1}, {"num_envs": 5}, {"seed": -1}, {"offset": math.nan}, {"lengths": (1.0, 10.0)}):
        with pytest.raises(ValueError, match=rf"^{next(iter(bad))} is "):
            Mine(**bad)


def test_the_json_form_leaves_out_how_a_process_starts_and_comes_back():
    config = Mine(seed=3, resume_from=Path("a/b"), ppo=PPOConfig(epochs=2))
    settings = json.loads(json.dumps(as_json(config)))
    assert "resume_from" not in settings
    assert from_json(Mine, settings) == Mine(seed=3, ppo=PPOConfig(epochs=2))
    with pytest.raises(ValueError, match=r"unknown \['resume_from'\]"):
        from_json(Mine, settings | {"resume_from": "a/b"})


def test_a_setting_out_of_bounds_is_refused_on_a_command_line_too():
    with pytest.raises(ValueError, match="learning_rate is nan"):
        with_settings(Mine(), {"ppo.learning_rate": "nan"})


def test_a_choice_is_one_of_its_words():
    config = find_recipe("ppt_push").config()
    assert with_settings(config, {"goal": "position"}).goal == "position"
    with pytest.raises(ValueError, match=r"option goal is 'place'; expected one of \['position', 'pose'\]"):
        with_settings(config, {"goal": "place"})


def test_with_another_goal_what_was_left_to_it_follows_and_what_was_set_stays():
    config = find_recipe("st_push").config()
    assert (config.duration, config.e_max, config.energy_penalty, config.max_velocity) == (1.5, 1.3, 0.5, 0.4)
    moved = with_settings(config, {"goal": "position"})
    assert moved == find_recipe("st_push").config(goal="position")
    for settings in ({"duration": "1.5", "goal": "position"}, {"goal": "position", "duration": "1.5"}):
        assert with_settings(config, settings) == find_recipe("st_push").config(goal="position", duration=1.5)
    assert with_settings(config, {"goal": "pose"}) == config
    mine = find_recipe("st_push").config(e_max=0.7)
    assert with_settings(mine, {"goal": "position"}).e_max == 0.7


def test_several_settings_of_one_nested_group_are_all_taken():
    ppo = with_settings(find_recipe("s_push").config(), {"ppo.gamma": "0.9", "ppo.epochs": "3"}).ppo
    assert (ppo.gamma, ppo.epochs) == (0.9, 3)


@pytest.mark.parametrize("variant", shipped_recipes())
def test_the_preset_for_a_gpu_changes_defaults_only(variant):
    options = find_recipe(variant).config
    preset = preset_options(options, ["--seed", "3", "--preset", "gpu"])
    assert preset.device == "cuda"
    assert preset.num_envs >= 1024
    assert preset == preset_options(options, ["--preset=gpu"])
    assert preset_options(options, ["--seed", "3"]) is None
    assert preset_options(options, ["--preset", "other"]) is None
    plain = as_json(options())
    assert {key for key, value in as_json(preset).items() if value != plain[key]} <= {
        "num_envs", "ppo", "validate_every", "validation_episodes"
    }  # fmt: skip


def test_options_on_the_command_line_stand_beside_those_of_a_preset(capsys):
    taken = []
    recipe = replace(find_recipe("ppt_push"))
    object.__setattr__(recipe, "train", taken.append)
    recipe.main(["--preset", "gpu", "--num-envs", "64"])
    assert (taken[0].num_envs, taken[0].device, taken[0].ppo.minibatches) == (64, "cuda", 8)


def test_a_gpu_that_is_not_there_is_refused_with_what_there_is():
    with pytest.raises(ValueError, match=r"device is 'cuda:77', and torch .* sees \d+ GPUs here"):
        PushEnv(1, device="cuda:77")
