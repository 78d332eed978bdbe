from __future__ import annotations

import gzip
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from ppt_rl.envs.mujoco_imports import rendering_backend
from ppt_rl.evaluation import COLUMNS, Study, find_recipes, load_policy, run_study
from ppt_rl.evaluation.runs import KeptRun
from ppt_rl.evaluation.study_report import _budget

SETTINGS = {
    "num_envs": "4", "num_threads": "1", "duration": "0.2", "physics_dt": "0.002", "ppo.total_control_steps": "240",
}  # fmt: skip


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("study")


def tiny(place: Path, *names: str, **changes: object) -> Study:
    study = Study(
        find_recipes(names or ("push",)), seeds=1, runs=place / "runs", results=place / "results",
        publish=place / "published", episodes=4, num_envs=4, settings=SETTINGS,
    )  # fmt: skip
    return replace(study, **changes)


@pytest.fixture(scope="module")
def finished(place: Path) -> Study:
    study = tiny(place)
    run_study(study)
    return study


def test_a_task_stands_for_all_of_its_variants_in_the_papers_order():
    assert [recipe.label for recipe in find_recipes(["push"])] == ["PP", "PPT", "S", "ST"]
    assert [recipe.variant for recipe in find_recipes(["s_push", "pp_push"])] == ["s_push", "pp_push"]


def test_a_study_leaves_tables_figures_and_policies_of_every_variant(finished):
    results = finished.results_dir
    names = {path.name for path in results.iterdir()}
    figures = {"training.png", "metrics_6_cm.png", "metrics_8_cm.png", "promp.png", "tank.png"}
    if rendering_backend() != "disable":
        figures.add("filmstrip.png")
    assert {"runs", "tables.md", "summary.json"} | figures <= names
    summary = json.loads((results / "summary.json").read_text())
    assert summary["seeds"] == {"PP": 1, "PPT": 1, "S": 1, "ST": 1}
    assert set(summary["metrics"]["PPT"]) == set(COLUMNS)
    assert set(summary["episodes"]) == {"PP", "PPT", "S", "ST", "reference alone, PP", "reference alone, PPT"} | {
        "naive reference, PP",
        "naive reference, PPT",
    }
    assert summary["improvement"]["PPT > ST"]["ci95"] is None
    assert {verdict["verdict"] for verdict in summary["orderings"]} == {"not resolved"}  # one seed
    for run in finished.planned():
        assert (finished.publish / run.recipe.variant / "policy.safetensors").exists()


def test_the_tables_can_be_recomputed_from_the_episodes(finished):
    for run in finished.planned():
        episodes, record = run.episodes(), run.evaluation()
        assert record["groups"] == ["6 cm", "8 cm"]
        for index, (label, size) in enumerate((("6 cm", 0.06), ("8 cm", 0.08))):
            rows = episodes["group"] == index
            assert rows.sum() == finished.episodes
            np.testing.assert_allclose(episodes["box_size"][rows], size, rtol=1e-6)
            for metric in COLUMNS:
                mean = record["summary"][run.recipe.variant][label][metric]["mean"]
                assert mean == pytest.approx(episodes[metric][rows].mean())


def test_the_validations_of_a_run_are_kept_with_its_curves(finished):
    for run in finished.planned():
        validation = run.validation()
        assert validation["control_steps"].tolist() == [0.0]  # three batches are less than the fourteen between two
        assert validation["max_power"][0] > 0


def test_the_baselines_meet_the_episodes_of_the_policy(finished):
    run = next(run for run in finished.planned() if run.recipe.variant == "ppt_push")
    assert run.actors() == ["ppt_push", "reference alone", "naive reference"]
    np.testing.assert_array_equal(run.episodes()["box_size"], run.episodes("reference alone")["box_size"])


def test_recorded_rollouts_hold_what_was_observed_at_every_control_step(finished):
    for run in finished.planned():
        rollouts = run.rollouts()
        assert rollouts["steps"].tolist() == [20] * 4
        assert rollouts["box_pose"].shape == (4, 20, 7)
        assert ("valve" in rollouts) == run.recipe.has_tank


def test_finished_runs_are_not_repeated_and_a_new_seed_is_added(finished, place):
    before = {run.recipe.variant: (run.results / "evaluation.json").stat().st_mtime_ns for run in finished.planned()}
    run_study(tiny(place, "pp_push", "s_push", seeds=2))
    for run in finished.planned():
        assert (run.results / "evaluation.json").stat().st_mtime_ns == before[run.recipe.variant]
    assert (finished.results_dir / "runs" / "pp_push-seed1" / "evaluation.json").exists()
    assert json.loads((finished.results_dir / "summary.json").read_text())["seeds"] == {"PP": 2, "S": 2}


def test_a_run_cut_off_in_training_continues_from_its_checkpoint(tmp_path):
    study = tiny(tmp_path, "ppt_push", publish=None)
    (run,) = study.planned()
    short = replace(study, settings=SETTINGS | {"ppo.total_control_steps": "80"})
    run.recipe.train(short.config(run))
    run_study(study)
    assert run.curves()["control_steps"].tolist() == [80, 160, 240]


def test_a_published_policy_acts_like_the_run_it_comes_from(finished):
    run = next(run for run in finished.planned() if run.recipe.variant == "ppt_push")
    policies = [load_policy(run.run_dir), load_policy(finished.publish / "ppt_push")]
    actions = [policy.actor(policy.make_env(num_envs=2, seed=3).reset())["loc"] for policy in policies]
    assert bool((actions[0] == actions[1]).all())


def test_a_report_says_how_long_each_variant_trained_where_that_differs(finished, tmp_path):
    one, other = (run for run in finished.planned() if run.recipe.variant in ("pp_push", "s_push"))
    assert _budget({"PP": [one], "S": [other]}) == "240"
    longer = SimpleNamespace(config=lambda: SimpleNamespace(ppo=SimpleNamespace(total_control_steps=24_000)))
    assert _budget({"PP": [one], "S": [longer]}) == "240 (PP), 24,000 (S)"


def test_a_report_needs_a_finished_run(tmp_path):
    with pytest.raises(ValueError, match="no finished run"):
        run_study(tiny(tmp_path), report_only=True)


@pytest.mark.parametrize(("name", "value"), [("seeds", 0), ("episodes", 0), ("num_envs", 0)])
def test_impossible_settings_of_a_study_are_refused(tmp_path, name, value):
    with pytest.raises(ValueError, match=f"{name} is 0; expected a whole number from 1 to"):
        tiny(tmp_path, **{name: value})


def test_a_study_of_two_tasks_is_refused(tmp_path):
    with pytest.raises(ValueError, match="expected recipes of one task"):
        tiny(tmp_path, "push", "maze")


def test_results_name_no_directory_of_the_machine(finished, root):
    record = json.loads((finished.publish / "ppt_push" / "card.json").read_text())
    assert record["config"]["run_dir"] == "runs/ppt_push"
    run: KeptRun = finished.planned()[0]
    assert str(root) not in gzip.decompress((run.results / "episodes.csv.gz").read_bytes()).decode()
