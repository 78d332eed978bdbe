from __future__ import annotations

import csv
import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
from tensordict import TensorDictBase
from torch import nn
from torchrl.checkpoint import Checkpoint
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from ppt_rl.evaluation import (
    COLUMNS,
    Policy,
    evaluate,
    find_recipe,
    load_policy,
    record_episodes,
    save_pretrained,
    shipped_recipes,
)
from ppt_rl.evaluation.drawing import draw_policy
from ppt_rl.evaluation.policy import restored_config
from ppt_rl.evaluation.published import card_digest
from ppt_rl.training import CheckpointMismatch, PPOConfig, as_json, checkpoint_info, find_checkpoint
from ppt_rl.training.logs import read_scalar
from ppt_rl.transforms import EnergyTankTransform

STEPS, HOLD = 20, 5  # control steps of an episode, and from one decision of a step-wise policy to the next
PUSH = ["JointTorqueTransform", "ImpedanceTransform", "EpisodeMetricsTransform"]
#: With the tank at the motors and the paper's, on the wrench.
TANKS = ["EnergyTankTransform", PUSH[0], "EnergyTankTransform", "EnergyPenaltyTransform", *PUSH[1:]]
PROMP = ["MacroStepTransform", "ProMPTransform", "ViaPointTransform"]
STEPWISE = ["CartesianVelocityTransform", "MacroStepTransform", "HoldActionTransform", "StepCounter", "UnaryTransform"]
#: Transforms of each variant in order; the tank acts at control rate, so it stands before the macro step.
CHAINS = {
    "lagrangian_push": [*PUSH[:2], "PowerLimitTransform", PUSH[2], *PROMP],
    "pp_push": [*PUSH, *PROMP],
    "ppt_budget_push": [*TANKS[:3], *TANKS[4:], *PROMP, "EnergyBudgetTransform"],
    "ppt_push": [*TANKS, *PROMP],
    "ppt_safe_push": [*TANKS[:-1], "ReferenceGovernorTransform", TANKS[-1], *PROMP],
    "s_push": [*PUSH, *STEPWISE],
    "st_push": [*TANKS, *STEPWISE],
}
KNOWN = ["box_start", "goal", "box_size", "pose", "twist", "wrench", "phase", "goal_yaw"]
#: What each policy reads besides.
EXTRA = {
    "lagrangian_push": [],
    "pp_push": [],
    "ppt_budget_push": ["tank_energy", "valve", "energy_budget"],
    "ppt_push": ["tank_energy", "valve"],
    "ppt_safe_push": ["tank_energy", "valve"],
    "s_push": ["reference_position", "last_action"],
    "st_push": ["reference_position", "last_action", "tank_energy", "valve"],
}
variants = pytest.mark.parametrize("variant", sorted(CHAINS))


def tiny(variant: str, run_dir: Path) -> Any:
    """Options of a training of two batches, an episode of four environments each."""
    recipe = find_recipe(variant)
    shape = {"hold_steps": HOLD} if variant in ("s_push", "st_push") else {"num_basis": 4}
    ppo = PPOConfig(total_control_steps=2 * 4 * STEPS, epochs=2, minibatches=2)
    return recipe.config(run_dir=run_dir, num_envs=4, num_threads=1, duration=0.2, physics_dt=0.002, ppo=ppo, **shape)


class Untrained(NamedTuple):
    """What stands before a training: options, environment and networks."""

    config: Any
    env: EnvBase
    actor: nn.Module
    critic: nn.Module


@pytest.fixture(scope="module")
def untrained() -> dict[str, Untrained]:
    """Every variant with limits of its own."""
    made = {}
    for variant in sorted(CHAINS):
        recipe, config = find_recipe(variant), replace(tiny(variant, Path("unused")), p_max=1.25)
        if recipe.has_tank:
            config = replace(config, e_max=2.5)
        base = recipe.task.make_training_env(config, num_envs=4, seed=0, audit=True)
        env = recipe.on(base, config, recipe.make_modules(config))
        made[variant] = Untrained(config, env, *recipe.make_policy(config, env))
    return made


class Trained(NamedTuple):
    """A finished training: its checkpoint, and what it left in memory."""

    path: Path
    config: Any
    actor: nn.Module
    critic: nn.Module
    modules: dict[str, nn.Module]


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Trained]:
    """A tiny training of each variant."""
    runs = {}
    for variant in sorted(CHAINS):
        recipe, made = find_recipe(variant), {}

        def keep(name, make, made=made):
            return lambda *args: made.setdefault(name, make(*args))

        config = tiny(variant, tmp_path_factory.mktemp(variant))
        watched = replace(
            recipe,
            make_policy=keep("policy", recipe.make_policy),
            make_modules=keep("modules", recipe.make_modules),
        )
        path = watched.train(config)
        runs[variant] = Trained(path, config, *made["policy"], made.get("modules", {}))
    return runs


@pytest.fixture(scope="module")
def policies(trained: dict[str, Trained]) -> dict[str, Policy]:
    """The policies of the checkpoints."""
    return {variant: load_policy(run.path) for variant, run in trained.items()}


@torch.no_grad()
def episode(env: EnvBase, actor: nn.Module) -> TensorDictBase:
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        return env.rollout(STEPS, actor)


def chain(env: EnvBase) -> list[str]:
    return [type(transform).__name__ for transform in env.transform]


# -- the variants ------------------------------------------------------------------------------------------------------


def test_the_registry_knows_every_pushing_recipe_by_its_own_name(root):
    files = {path.stem for path in (root / "recipes").glob("ppo_*_push.py")}
    names = {name for name in shipped_recipes() if name.endswith("_push")}
    assert {f"ppo_{name}" for name in names} == files
    assert {name: find_recipe(name).variant for name in names} == {name: name for name in CHAINS}


@variants
def test_the_chain_of_a_variant_is_what_its_name_says(untrained, variant):
    env = untrained[variant].env
    assert chain(env) == CHAINS[variant]
    assert ("tank_energy" in env.observation_spec.keys()) == find_recipe(variant).has_tank


@variants
def test_the_tank_and_the_metrics_have_the_limits_of_the_options(untrained, variant):
    parts = {type(part).__name__: part for part in untrained[variant].env.transform}
    assert parts["EpisodeMetricsTransform"].config.p_max == 1.25
    if find_recipe(variant).has_tank:
        tanks = [part for part in untrained[variant].env.transform if isinstance(part, EnergyTankTransform)]
        margin = getattr(untrained[variant].config, "motor_margin", 1.0)  # of the limit at the motors
        assert [tank.p_max for tank in tanks] == [1.25 * margin, 1.25]
        assert [(tank.e_max, tank.dt) for tank in tanks] == [(2.5, 0.01)] * 2
        assert [tank.flow_key for tank in tanks] == ["joint_velocity", "twist"]


@variants
def test_the_policy_reads_nothing_privileged_and_the_critic_does(untrained, variant):
    _, env, actor, critic = untrained[variant]
    assert sorted(actor.in_keys) == sorted(KNOWN + EXTRA[variant])
    assert sorted(critic.in_keys) == sorted([*KNOWN, *EXTRA[variant], "box_pose"])
    tensordict = env.reset()
    with torch.no_grad():
        action, value = actor(tensordict.clone())["loc"], critic(tensordict.clone())["state_value"]
        known = tensordict.select(*actor.in_keys)
        assert torch.equal(actor(known.clone())["loc"], action)
        tensordict["box_pose"] = torch.randn_like(tensordict["box_pose"])
        assert torch.equal(actor(tensordict.clone())["loc"], action)
        assert not torch.equal(critic(tensordict.clone())["state_value"], value)
        for key in actor.in_keys:  # each of them counts
            other = known.clone()
            other[key] = other[key] + 1.0
            assert not torch.equal(actor(other)["loc"], action), key


@pytest.mark.parametrize("variant", ["s_push", "st_push"])
def test_the_phase_of_a_stepwise_policy_is_the_part_of_the_episode_that_is_over(untrained, variant):
    env = untrained[variant].env
    decisions = STEPS // HOLD
    run = env.rollout(decisions + 3, lambda td: td.set("action", env.action_spec.zero()), break_when_any_done=False)
    expected = torch.cat([torch.arange(decisions), torch.arange(3)]) / decisions
    torch.testing.assert_close(run["phase"][0, :, 0], expected)


# -- training and bringing back ----------------------------------------------------------------------------------------


@variants
def test_a_tiny_training_leaves_a_checkpoint_and_logs(trained, variant):
    run = trained[variant]
    assert run.path == find_checkpoint(run.config.run_dir)
    assert checkpoint_info(run.path, variant)["config"] == as_json(run.config)
    for name in ("reward", "success", "work", "max_power", "kl"):
        steps, values = read_scalar(run.config.run_dir, name)
        assert steps.tolist() == [4 * STEPS, 8 * STEPS]
        assert np.isfinite(values).all()
    with pytest.raises(CheckpointMismatch, match=f"is of variant '{variant}'; expected 'pull'"):
        checkpoint_info(run.path, "pull")


@variants
def test_a_checkpoint_brings_back_the_policy_with_its_chain_to_the_bit(trained, policies, variant):
    run, policy = trained[variant], policies[variant]
    assert (policy.variant, policy.recipe, policy.config) == (variant, find_recipe(variant), run.config)
    assert list(policy.modules) == list(run.modules)
    recipe = find_recipe(variant)
    there = episode(recipe.make_env(run.config, run.modules, num_envs=3, seed=17), run.actor)
    back = episode(policy.make_env(num_envs=3, seed=17), policy.actor)
    assert there["next", "done"][:, -1].all()
    for key in ("action", ("next", "pose"), ("next", "reward"), ("next", "metrics", "work")):
        assert torch.equal(there[key], back[key]), key
    assert not torch.equal(there["action"][0], there["action"][1])


def test_a_run_directory_stands_for_its_newest_checkpoint(trained):
    run = trained["s_push"]
    for a, b in zip(load_policy(run.config.run_dir).actor.parameters(), run.actor.parameters(), strict=True):
        assert torch.equal(a, b)


@variants
def test_the_evaluated_environment_hides_what_is_privileged(policies, variant):
    policy = policies[variant]
    env = policy.make_env(num_envs=2, seed=0, audit=True)
    assert chain(env) == [*CHAINS[variant], "ExcludeTransform"]
    step = env.step(policy.actor(env.reset()))
    assert "box_pose" not in env.observation_spec.keys()
    assert not [key for key in step.keys(True, True) if "box_pose" in key]
    assert (step["next", "audit", "commanded_power"] > 0).all()
    assert "box_pose" in policy.make_env(num_envs=2, seed=0, privileged=True).observation_spec.keys()


@pytest.mark.parametrize("size", [0.06, 0.08])
def test_options_of_the_environment_can_be_changed_for_an_evaluation(policies, size):
    env = policies["s_push"].with_changes(box_sizes=(size,), num_threads=1).make_env(num_envs=3, seed=0)
    assert (env.reset()["box_size"] == size).all()


# -- evaluation --------------------------------------------------------------------------------------------------------


def test_a_stepwise_policy_has_a_report_of_its_own(trained, tmp_path, monkeypatch):
    monkeypatch.setattr("ppt_rl.envs.rendering.rendering_backend", lambda: "disable")  # a video takes seconds
    policy = load_policy(trained["s_push"].path)
    evaluate(policy, episodes=4, seed=1, num_envs=4).write(tmp_path)
    draw_policy(policy, tmp_path, episodes=2, seed=1)
    names = {"evaluation.md", "evaluation.json", "audit.json", "episodes.csv", "episode.png", "training.png"}
    assert {path.name for path in tmp_path.iterdir()} == names
    (label, row), *others = json.loads((tmp_path / "evaluation.json").read_text()).items()
    assert (label, list(row), others) == ("s_push", list(COLUMNS), [])
    with (tmp_path / "episodes.csv").open() as file:
        episodes = list(csv.DictReader(file))
    assert len(episodes) == 4
    assert all(float(each["audit_commanded_work"]) > 0 for each in episodes)


@pytest.mark.parametrize("variant", ["ppt_push", "s_push"])
def test_a_recorded_episode_holds_what_was_seen_after_each_of_its_control_steps(policies, variant):
    policy = policies[variant]
    recorded = record_episodes(policy.make_env(num_envs=2, seed=4), policy.actor, ["pose", "power"])
    assert recorded["trace", "pose"].shape == (2, STEPS, 7)
    assert recorded["control_steps"].tolist() == [[STEPS]] * 2
    run = episode(policy.make_env(num_envs=2, seed=4), policy.actor)["next"]
    assert torch.equal(recorded["trace", "pose"][:, -1], run["pose"][:, -1])
    assert torch.equal(recorded["metrics", "work"], run["metrics", "work"][:, -1])
    work = 0.01 * recorded["trace", "power"].abs().sum(1)
    torch.testing.assert_close(recorded["metrics", "work"], work)


@variants
def test_only_a_policy_on_residuals_has_a_reference_to_run_alone(policies, variant):
    has_one = variant not in ("s_push", "st_push")
    assert policies[variant].baselines() == (["reference alone", "naive reference"] if has_one else [])
    if not has_one:
        with pytest.raises(ValueError, match=f"'reference alone' is unknown for {variant}; expected one of"):
            policies[variant].make_baseline("reference alone")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"colour": "red"}, r"another version of s_push: .*unknown \['colour'\]"),
        ({"ppo": as_json(PPOConfig()) | {"epochs": 0}}, "another version of s_push: epochs is 0"),
        ({"ppo": {"tempo": 1}}, r"another version of s_push: the settings of PPOConfig .*unknown \['tempo'\]"),
    ],
)
def test_a_checkpoint_with_options_that_the_recipe_does_not_have_is_refused(trained, tmp_path, change, message):
    run = trained["s_push"]
    settings = as_json(run.config) | change
    with pytest.raises(CheckpointMismatch, match=message):
        restored_config(find_recipe("s_push"), settings, run.path)
    path = tmp_path / "edited.torchrl"
    metadata = {"variant": "s_push", "config": settings, "success": 0.0}
    Checkpoint(format="archive", actor=run.actor).save(path, metadata=metadata)
    with pytest.raises(CheckpointMismatch, match=message):
        load_policy(path)


def test_options_come_back_from_their_json_as_they_were(trained):
    for variant, run in trained.items():
        assert restored_config(find_recipe(variant), as_json(run.config) | {"variant": variant}, run.path) == run.config


def test_a_checkpoint_from_before_an_option_was_there_has_its_default(trained):
    run = trained["s_push"]
    settings = as_json(run.config)
    del settings["box_masses"], settings["max_lead"]
    assert restored_config(find_recipe("s_push"), settings, run.path) == run.config


def test_a_checkpoint_of_one_variant_does_not_fit_another(trained, tmp_path):
    path = tmp_path / "edited.torchrl"
    run = trained["pp_push"]
    settings = as_json(run.config) | {"e_max": 3.0}
    metadata = {"variant": "ppt_push", "config": settings, "success": 0.0}
    Checkpoint(format="archive", actor=run.actor, **run.modules).save(path, metadata=metadata)
    with pytest.raises(CheckpointMismatch, match="does not fit"):
        load_policy(path)


# -- published policies ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def published(trained, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Directory of a published PPT policy."""
    run, directory = trained["ppt_push"], tmp_path_factory.mktemp("published")
    card = {"variant": "ppt_push", "config": as_json(run.config)}
    save_pretrained(directory, {"actor": run.actor, **run.modules}, card)
    return directory


def test_a_published_policy_is_evaluated_like_the_checkpoint_it_comes_from(trained, published):
    tables = []
    for path in (published, trained["ppt_push"].path):
        tables.append(evaluate(load_policy(path), episodes=4, num_envs=4, seed=3).as_json())
    assert tables[0] == tables[1]
    assert list(tables[0]) == list(COLUMNS)


def damaged(published: Path, place: Path, name: str) -> Path:
    """A copy of a published policy with one byte of a file flipped."""
    copy = Path(shutil.copytree(published, place / "copy"))
    data = bytearray((copy / name).read_bytes())
    data[len(data) // 2] ^= 0x01
    (copy / name).write_bytes(data)
    return copy


def test_a_published_policy_that_was_tampered_with_ends_the_program_with_advice(published, tmp_path):
    copy = damaged(published, tmp_path, "policy.safetensors")
    run = subprocess.run(
        [sys.executable, "-m", "ppt_rl", "evaluate", str(copy), "--episodes", "2"], capture_output=True, text=True
    )
    assert run.returncode == 2
    assert "SHA-256" in run.stderr
    assert "Take a fresh copy" in run.stderr
    assert "Traceback" not in run.stderr
    assert run.stdout == ""


def test_a_card_of_a_variant_that_does_not_exist_is_refused(published, tmp_path):
    copy = Path(shutil.copytree(published, tmp_path / "copy"))
    card = json.loads((copy / "card.json").read_text()) | {"variant": "os.system"}
    card["sha256"] = card_digest(card, (copy / "policy.safetensors").read_bytes())
    (copy / "card.json").write_text(json.dumps(card))
    with pytest.raises(CheckpointMismatch, match=r"'os\.system' is unknown; expected one of"):
        load_policy(copy)
