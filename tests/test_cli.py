from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from ppt_rl.commands import CalibrateTank, Evaluate, Film, Judged, Policies, Sweep, _pairs
from ppt_rl.envs.mujoco_imports import rendering_backend
from ppt_rl.evaluation import COLUMNS, find_recipe, shipped_recipes
from ppt_rl.recipes.ppo_ppt_push import Config
from ppt_rl.training import with_settings
from ppt_rl.training.logs import read_scalar
from ppt_rl.view_command import View

QUICK = ("physics_dt=0.002", "duration=1.5")


def command(*args: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "ppt_rl", *args], cwd=cwd, capture_output=True, text=True)


def test_help_names_every_command_without_importing_torch(tmp_path):
    code = """
import sys
from ppt_rl import cli
sys.argv = ["ppt-rl", "--help"]
try:
    cli.main()
except SystemExit:
    assert "torch" not in sys.modules
"""
    run = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert all(
        name in run.stdout
        for name in ("train", "evaluate", "film", "view", "study", "calibrate-tank", "sweep", "collide", "policies")
    )


def test_the_last_line_of_an_evaluation_is_json_from_any_folder(tmp_path):
    run = command(
        "evaluate", "ppt_push", "--episodes", "4", "--seed", "5", "--json", "--baseline", "--set", *QUICK, cwd=tmp_path
    )
    assert run.returncode == 0, run.stderr
    report = json.loads(run.stdout.splitlines()[-1])
    assert list(report) == [*COLUMNS, "baselines"]
    assert list(report["baselines"]) == ["reference alone", "naive reference"]


@pytest.mark.parametrize("variant", ["ppt_push", "st_maze"])
def test_help_of_a_training_shows_the_options_of_its_recipe(tmp_path, variant):
    run = command("train", variant, "--help", cwd=tmp_path)
    assert run.returncode == 0
    assert "--run-dir" in run.stdout
    assert f"runs/{variant}" in run.stdout


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("train", "nothing"), "recipe 'nothing' is unknown; expected one of"),
        (("evaluate", "nothing"), "nothing does not exist; expected a checkpoint or a run's directory"),
        (("evaluate", "ppt_push", "--set", "p_max"), "expected NAME=VALUE"),
        # tests/bad_inputs has these in one process, which is quicker
        pytest.param(
            ("evaluate", "ppt_push", "--set", "pmax=1"),
            "option 'pmax' is unknown; expected one of",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            ("evaluate", "ppt_push", "--set", "p_max=much"),
            "option p_max is 'much'; expected float",
            marks=pytest.mark.slow,
        ),
        pytest.param(("evaluate", "ppt_push", "--set", "arm=octopus"), "octopus", marks=pytest.mark.slow),
        pytest.param(("evaluate", "pp_push", "--set", "e_max=1"), "option 'e_max' is unknown", marks=pytest.mark.slow),
        pytest.param(
            ("evaluate", "ppt_push", "--episodes", "0"),
            "episodes is 0; expected a whole number from 1 to",
            marks=pytest.mark.slow,
        ),
        pytest.param(("study", "push", "ppt_maze"), "expected recipes of one task", marks=pytest.mark.slow),
        pytest.param(("sweep", "ppt_push"), "expected policies of one task that has a sweep", marks=pytest.mark.slow),
        pytest.param(
            ("calibrate-tank", "ppt_push", "--quantile", "2"),
            "quantile is 2.0; expected a share",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_mistake_ends_with_one_line_of_advice(tmp_path, args, message):
    run = command(*args, cwd=tmp_path)
    assert run.returncode == 2
    assert message in run.stderr
    assert "Traceback" not in run.stderr


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (lambda place: Evaluate("s_push", report=place / "file" / "report"), "Not a directory"),
        (lambda place: Evaluate("s_push", report=place / "file"), "File exists"),
        (lambda place: CalibrateTank("s_push", report=place / "file"), "File exists"),
        (lambda place: Sweep(("s_push",), report=place / "file"), "File exists"),
        (lambda place: Film("s_push", output=place / "file" / "a.mp4"), "File exists"),
        (lambda place: Evaluate("s_push", report=Path("/proc/report")), "No such file or directory"),
    ],
)
def test_a_place_that_cannot_be_written_to_is_refused_before_the_work(tmp_path, monkeypatch, options, reason):
    def never(*args, **kwargs):
        raise AssertionError("work was done")

    for name in ("evaluate", "calibrate", "run_sweep", "drawing.film"):
        monkeypatch.setattr(f"ppt_rl.evaluation.{name}", never)
    (tmp_path / "file").touch()
    with pytest.raises(ValueError, match=rf"where nothing can be written \({reason}\); expected a folder"):
        options(tmp_path).run()


def test_a_film_needs_a_file_and_not_a_directory(tmp_path):
    with pytest.raises(ValueError, match=r"output is .*; expected the path of a file that ends in \.mp4"):
        Film("s_push", output=tmp_path).run()


def test_an_error_of_the_system_ends_with_one_line_of_advice(tmp_path):
    (tmp_path / "file").touch()
    run = command("evaluate", "s_push", "--report", "file", cwd=tmp_path)
    assert run.returncode == 2
    last = run.stderr.splitlines()[-1]
    assert last.startswith("ppt-rl: error: report is file, where nothing can be written (File exists); expected")
    assert "Traceback" not in run.stderr


def test_a_run_is_resumed_by_the_command_without_its_options(tmp_path):
    options = ("--num-envs", "2", "--num-threads", "1", "--duration", "0.1", "--physics-dt", "0.005", "--hold-steps")
    budget = ("--ppo.total-control-steps", "20")
    place = ("train", "s_push", "--run-dir", "mine")
    assert command(*place, *options, "1", *budget, cwd=tmp_path).returncode == 0
    again = command(*place, "--resume", "--ppo.total-control-steps", "40", cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    assert read_scalar(tmp_path / "mine", "reward")[0].tolist() == [20, 40]


def test_published_policies_are_listed_with_their_figures(capsys):
    Policies().run()
    text = capsys.readouterr().out
    assert all(f"| {variant} |" in text for variant in shipped_recipes() if find_recipe(variant).in_study)
    assert "success [0-1]" in text


@pytest.mark.skipif(rendering_backend() == "disable", reason="no OpenGL library is installed")
@pytest.mark.parametrize("name", ["s.mp4", "s.gif"])
def test_a_policy_is_filmed(tmp_path, capsys, name):
    Film("s_push", settings=("duration=0.2", "physics_dt=0.002"), output=tmp_path / name, episodes=1).run()
    assert (tmp_path / name).stat().st_size > 1_000
    assert str(tmp_path / name) in capsys.readouterr().out


def test_a_sweep_is_drawn_anew_from_its_numbers(tmp_path):
    with pytest.raises(ValueError, match=r"difficulty\.json cannot be read .*Run one first"):
        Sweep(("st_maze",), report=tmp_path, report_only=True).run()
    curves = {"width [mm]": {"ST": ([30.0, 40.0], [1.0, 0.5], [(0.9, 1.0), (0.3, 0.7)])}}
    (tmp_path / "difficulty.json").write_text(json.dumps(curves))
    Sweep(("st_maze",), report=tmp_path, report_only=True).run()
    assert (tmp_path / "difficulty.png").stat().st_size > 5_000


@pytest.mark.parametrize(("missing", "options"), [("viser", ("view", "ppt_push"))])
def test_a_missing_package_is_one_line_of_advice(tmp_path, missing, options):
    code = f"""
import importlib.util, sys
find = importlib.util.find_spec
importlib.util.find_spec = lambda name, *more: None if name == {missing!r} else find(name, *more)
from ppt_rl import cli
sys.argv = ["ppt-rl", *{options!r}]
cli.main()
"""
    run = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert run.returncode == 2
    last = run.stderr.splitlines()[-1]
    assert last.startswith(f"ppt-rl: error: the live view needs the package {missing}, which is not installed")
    assert "Traceback" not in run.stderr


def test_an_evaluation_writes_its_report(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("ppt_rl.envs.rendering.rendering_backend", lambda: "disable")
    Evaluate("s_push", settings=("duration=0.2", "physics_dt=0.002"), episodes=2, report=tmp_path).run()
    assert {"evaluation.md", "episode.png"} <= {path.name for path in tmp_path.iterdir()}
    assert "success [0-1]" in capsys.readouterr().out


def test_options_are_set_in_the_type_of_their_field():
    config = with_settings(
        Config(), _pairs(("p_max=0.5", "box_sizes=0.06,0.08", "resume=true", "ppo.epochs=3", "run_dir=a/b"))
    )
    assert (config.p_max, config.box_sizes, config.resume, config.ppo.epochs) == (0.5, (0.06, 0.08), True, 3)
    assert config.run_dir == Path("a/b")


def test_a_policy_is_loaded_with_its_changed_options():
    assert Judged("ppt_push", settings=("p_max=0.5",), num_threads=1).load().config.p_max == 0.5


def test_a_policy_is_viewed_on_one_thread_of_the_processor():
    config = View("ppt_push", settings=("p_max=0.5",)).load().config
    assert (config.p_max, config.num_threads, config.device, config.engine) == (0.5, 1, "cpu", "threads")
