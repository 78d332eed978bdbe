from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ppt_rl.evaluation import load_policy
from ppt_rl.evaluation.runs import KeptRun, keep_run
from ppt_rl.evaluation.tables import from_csv
from ppt_rl.functional import PIDGains
from ppt_rl.recipes.ppo_lagrangian_push import RECIPE, Config
from ppt_rl.training import CheckpointMismatch, PPOConfig, as_json, from_json, with_settings
from ppt_rl.training.logs import read_scalar
from ppt_rl.transforms import PowerLimitTransform

BATCH = 4 * 20  # control steps of a batch: environments times steps of an episode
LOGGED = ("reward", "loss_objective", "loss_critic", "loss_cost_critic", "kl", "cost", "multiplier")


def tiny(run_dir: Path, batches: int = 3, **changes: object) -> Config:
    ppo = PPOConfig(total_control_steps=batches * BATCH, epochs=2, minibatches=2, checkpoint_every=1)
    config = Config(run_dir=run_dir, num_envs=4, num_threads=1, duration=0.2, physics_dt=0.002, num_basis=4, ppo=ppo)
    return replace(config, **{"cost_limit": 1e-3, "validate_every": 0, **changes})


def scalars(run_dir: Path, names: tuple[str, ...] = LOGGED) -> np.ndarray:
    return np.stack([read_scalar(run_dir, name)[1] for name in names])


@pytest.fixture(scope="module")
def begun(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of two batches; it is only copied."""
    run_dir = tmp_path_factory.mktemp("begun") / "run"
    RECIPE.train(tiny(run_dir, 2))
    return run_dir


@pytest.mark.parametrize("replan_steps", [0, 6])
def test_the_cost_is_the_work_of_the_episodes_and_moves_the_multiplier(tmp_path, replan_steps):
    RECIPE.train(tiny(tmp_path, replan_steps=replan_steps))
    cost, work, limit, multiplier = scalars(tmp_path, ("cost", "work", "cost_limit", "multiplier"))
    np.testing.assert_allclose(cost, work, rtol=1e-5)
    assert (limit == 1e-3).all()
    np.testing.assert_allclose(multiplier, 4.0 * (cost - 1e-3) + 0.15 * np.cumsum(cost - 1e-3), rtol=1e-9)


def test_the_excess_is_the_part_of_the_work_above_the_limit_of_power(tmp_path):
    RECIPE.train(tiny(tmp_path, 1, cost="excess", p_max=0.2, cost_limit=0.0))
    cost, work = scalars(tmp_path, ("cost", "work"))
    assert (cost > 0).all()
    assert (cost < work).all()


def test_one_critic_learns_the_penalised_reward(tmp_path):
    RECIPE.train(tiny(tmp_path, 1, cost_critic=False))
    assert np.isfinite(scalars(tmp_path, ("multiplier", "loss_critic"))).all()
    assert not (tmp_path / "logs" / "csv" / "scalars" / "loss_cost_critic.csv").exists()


def test_a_run_that_was_killed_goes_on_exactly_as_one_that_was_stopped(begun, tmp_path):
    killed = shutil.copytree(begun, tmp_path / "killed")
    stopped = shutil.copytree(begun, tmp_path / "stopped")
    with (killed / "logs" / "csv" / "scalars" / "multiplier.csv").open("a") as file:
        file.write(f"{3 * BATCH},9.0\n{4 * BATCH}")  # what it logged after its last checkpoint, torn by the kill
    for run_dir in (killed, stopped):
        RECIPE.train(tiny(run_dir, 4, resume=True))
    assert np.array_equal(scalars(killed), scalars(stopped))
    cost, multiplier = scalars(killed, ("cost", "multiplier"))
    excess = cost - 1e-3  # the integral spans both processes
    np.testing.assert_allclose(multiplier, 4.0 * excess + 0.15 * np.cumsum(excess), rtol=1e-9)


def test_a_run_does_not_go_on_under_another_limit_or_other_gains(begun, tmp_path):
    run_dir = shutil.copytree(begun, tmp_path / "run")
    with pytest.raises(CheckpointMismatch, match=r"other values of cost_limit \(0.001 then, 0.5 now\)"):
        RECIPE.train(tiny(run_dir, 4, resume=True, cost_limit=0.5))
    with pytest.raises(CheckpointMismatch, match=r"other values of pid.integral \(0.15 then, 0.5 now\)"):
        RECIPE.train(tiny(run_dir, 4, resume=True, pid=PIDGains(4.0, 0.5)))


def test_a_study_keeps_the_cost_of_every_batch_with_its_limit_and_the_multiplier(begun, tmp_path):
    run = KeptRun(RECIPE, 1, begun, tmp_path)
    keep_run(run, load_policy(begun), episodes=2, seed=3, num_envs=2)
    kept = from_csv((tmp_path / "cost.csv").read_text())
    assert kept["control_steps"].tolist() == [BATCH, 2 * BATCH]
    np.testing.assert_allclose([kept["cost"], kept["multiplier"]], scalars(begun, ("cost", "multiplier")), rtol=1e-6)
    assert (kept["cost_limit"] == 1e-3).all()


# -- options -----------------------------------------------------------------------------------------------------------


def test_the_limit_follows_the_cost_unless_it_is_given():
    assert Config().cost_limit == 0.7
    assert Config(cost="excess").cost_limit == 0.1
    assert with_settings(Config(), {"cost": "excess"}).cost_limit == 0.1
    assert with_settings(Config(cost_limit=2.0), {"cost": "excess"}).cost_limit == 2.0
    assert with_settings(Config(), {"pid.integral": "0.5"}).pid == PIDGains(4.0, 0.5)


def test_the_options_survive_their_json_form():
    config = Config(cost="excess", pid=PIDGains(0.5, derivative=0.2), initial_multiplier=3.0, cost_critic=False)
    assert from_json(Config, as_json(config)) == config


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"cost": "force"}, r"cost is 'force'; expected one of \['work', 'excess'\]"),
        ({"cost_limit": 0.0}, "cost_limit is 0 J; expected more, since a box is not moved without work"),
        ({"cost_limit": -1.0}, "cost_limit is -1.0; expected a number from 0"),
        ({"initial_multiplier": 101.0}, "initial_multiplier is 101.0"),
        ({"pid": PIDGains(0.0, 0.0)}, "the gains of pid and initial_multiplier are all 0, so nothing limits the cost"),
    ],
)
def test_options_that_limit_nothing_or_are_impossible_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        Config(**changes)


def test_a_chain_without_a_cost_is_refused_before_training(tmp_path):
    def chain(*args, **kwargs):
        return [part for part in RECIPE.make_chain(*args, **kwargs) if not isinstance(part, PowerLimitTransform)]

    with pytest.raises(KeyError, match=r"a step has no cost 'cost', only .*Append a transform .*PowerLimitTransform"):
        replace(RECIPE, make_chain=chain).train(tiny(tmp_path))
