from __future__ import annotations

import gzip
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import calibrate_tank
import numpy as np
import pytest
import study
from registry import load_policy
from study_runs import Run

from ppt_rl.envs.mujoco_imports import rendering_backend
from ppt_rl.evaluation import REPORTED


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("study")


def tiny(place: Path, **changes: object) -> study.Config:
    config = study.Config(
        seeds=1, runs=place / "runs", results=place / "results", pretrained=place / "pretrained", episodes=4,
        num_envs=4, num_threads=1, total_control_steps=240, duration=0.2, physics_dt=0.002,
    )  # fmt: skip
    return replace(config, **changes)


@pytest.fixture(scope="module")
def finished(place: Path) -> study.Config:
    config = tiny(place)
    study.main(config)
    return config


def test_a_study_leaves_tables_figures_and_policies_of_every_variant(finished):
    results = finished.results_dir
    names = {path.name for path in results.iterdir()}
    figures = {"training.png", "metrics_6cm.png", "metrics_8cm.png", "promp.png", "tank.png"}
    if rendering_backend() != "disable":
        figures.add("filmstrip.png")
    assert {"runs", "tables.md", "summary.json"} | figures <= names
    summary = json.loads((results / "summary.json").read_text())
    assert summary["seeds"] == {"PP": 1, "PPT": 1, "S": 1, "ST": 1}
    assert set(summary["metrics"]["PPT"]) == set(REPORTED)
    assert {verdict["verdict"] for verdict in summary["orderings"]} == {"not resolved"}  # one seed
    for run in finished.planned():
        assert (finished.pretrained / run.variant / "policy.safetensors").exists()


def test_the_tables_can_be_recomputed_from_the_episodes(finished):
    for run in finished.planned():
        episodes, boxes = run.episodes(), run.evaluation()["boxes"]
        for label, size in (("6 cm", 0.06), ("8 cm", 0.08)):
            rows = np.isclose(episodes["box_size"], size)
            assert rows.sum() == finished.episodes
            for metric in REPORTED:
                assert boxes[label][metric]["mean"] == pytest.approx(episodes[metric][rows].mean())


def test_finished_runs_are_not_repeated_and_a_new_seed_is_added(finished, place, capsys):
    before = {run.variant: (run.results / "evaluation.json").stat().st_mtime_ns for run in finished.planned()}
    study.main(tiny(place, seeds=2, variants=("pp_push", "s_push")))
    assert "seed 0" not in capsys.readouterr().out
    for run in finished.planned():
        assert (run.results / "evaluation.json").stat().st_mtime_ns == before[run.variant]
    assert (finished.results_dir / "runs" / "pp_push-seed1" / "evaluation.json").exists()
    verdicts = json.loads((finished.results_dir / "summary.json").read_text())["seeds"]
    assert verdicts == {"PP": 2, "S": 2}


def test_a_run_cut_off_in_training_goes_on_from_its_checkpoint(finished, place, tmp_path):
    run = Run("ppt_push", 0, tmp_path / "runs" / "ppt_push-seed0", tmp_path / "results" / "runs" / "ppt_push-seed0")
    short = tiny(tmp_path, variants=("ppt_push",), pretrained=None, total_control_steps=80)
    study.recipe_of("ppt_push").main(study.recipe_config(short, run))
    study.main(replace(short, total_control_steps=240))
    assert run.curves()["control_steps"].tolist() == [80, 160, 240]


def test_a_published_policy_acts_like_the_run_it_comes_from(finished):
    run = next(run for run in finished.planned() if run.variant == "ppt_push")
    policies = [load_policy(run.run_dir), load_policy(finished.pretrained / "ppt_push")]
    actions = [policy.actor(policy.make_env(num_envs=2, seed=3).reset())["loc"] for policy in policies]
    assert bool((actions[0] == actions[1]).all())


def test_a_report_needs_a_finished_run(tmp_path):
    with pytest.raises(ValueError, match="no finished run"):
        study.main(tiny(tmp_path, report_only=True))


@pytest.mark.parametrize(("name", "value"), [("seeds", 0), ("variants", ("ppo",))])
def test_impossible_settings_of_a_study_are_refused(tmp_path, name, value):
    with pytest.raises(ValueError, match=name):
        tiny(tmp_path, **{name: value})


def test_results_name_no_directory_of_the_machine(finished, root):
    record = json.loads((finished.pretrained / "ppt_push" / "card.json").read_text())
    assert record["config"]["run_dir"] == "runs/ppt_push"
    text = gzip.decompress((finished.planned()[0].results / "episodes.csv.gz").read_bytes()).decode()
    assert str(root) not in text


def test_calibration_proposes_limits_that_leave_the_quantile_untouched(finished, tmp_path):
    run = calibrate_tank.Config(
        finished.pretrained / "ppt_push", episodes=8, num_envs=4, num_threads=1, quantile=0.75, report=tmp_path
    )
    result, rows = calibrate_tank.calibrate(run)
    assert result["proposal"]["p_max"] == pytest.approx(1.1 * np.quantile(rows["max_power"], 0.75))
    assert result["proposal"]["e_max"] == pytest.approx(1.1 * np.quantile(rows["work"], 0.75))
    calibrate_tank.main(run)
    assert (tmp_path / "calibration.png").exists()
    assert json.loads((tmp_path / "calibration.json").read_text())["variant"] == "ppt_push"


def test_calibration_takes_a_variant_without_a_tank_and_removes_the_limits_of_one_with(finished):
    for variant in ("s_push", "st_push"):
        _, rows = calibrate_tank.calibrate(
            calibrate_tank.Config(finished.pretrained / variant, episodes=4, num_envs=4, num_threads=1)
        )
        assert np.isfinite(rows["max_power"]).all()
    policy = load_policy(finished.pretrained / "ppt_push")
    limited = policy.make_env(num_envs=4, seed=0, p_max=0.01)
    free = policy.make_env(num_envs=4, seed=0, p_max=1e6, e_max=1e6)
    peaks = [
        float(env.step(policy.actor(env.reset()))["next", "metrics", "max_power"].max()) for env in (limited, free)
    ]
    assert peaks[0] <= 0.01 < peaks[1]


@pytest.mark.parametrize(("name", "value"), [("quantile", 0.0), ("quantile", 1.5), ("margin", 0.5)])
def test_impossible_settings_of_a_calibration_are_refused(name, value):
    with pytest.raises(ValueError, match=name):
        calibrate_tank.Config(Path("x"), **{name: value})


def test_the_command_line_of_a_study_explains_itself(root):
    run = subprocess.run([sys.executable, "recipes/study.py", "--help"], cwd=root, capture_output=True, text=True)
    assert run.returncode == 0
    assert "number of seeds" in run.stdout
