"""Bad arguments of the evaluation, and damaged logs and results of runs."""

from __future__ import annotations

import gzip
import math
import tempfile
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ppt_rl.evaluation import (
    Claim,
    Study,
    calibrate,
    distribution,
    evaluate,
    find_recipe,
    find_recipes,
    interval,
    load_policy,
    run_study,
    run_sweep,
    summarise,
)
from ppt_rl.evaluation.drawing import film
from ppt_rl.evaluation.figures import moving_average, plot_training
from ppt_rl.evaluation.runs import KeptRun, curves_csv
from ppt_rl.evaluation.statistics import judge, over_seeds
from ppt_rl.evaluation.tables import as_csv, from_csv, markdown
from ppt_rl.evaluation.video import write_video
from ppt_rl.training.logs import read_scalar
from tests.bad_inputs.entry import BadInput, bad, each
from tests.bad_inputs.shared import policy

__all__ = ["ENTRIES"]

_WHOLE = "{name} is {value}; expected a whole number"
_FEW = {"episodes": 2, "seed": 5}


def _of_policy(
    call: Callable[..., object], name: str, values: tuple[Any, ...], match: str, **kwargs: Any
) -> list[BadInput]:
    """Bad values of one argument of a call that takes a policy."""

    def run(**given: Any) -> object:
        return call(policy(), **{**_FEW, **given})

    run.__qualname__ = call.__qualname__
    return each(run, name, values, match, **kwargs)


_JUDGED = [
    *_of_policy(evaluate, "episodes", (0, -5, 2.5, math.nan, "many", None, 10**12), _WHOLE),
    *_of_policy(evaluate, "seed", (-1, 1.5, "lucky"), _WHOLE),
    *_of_policy(evaluate, "num_envs", (0, -1, 2.5, "all", 10**9), _WHOLE),
    *_of_policy(calibrate, "episodes", (0, 10**12), _WHOLE),
    *_of_policy(calibrate, "quantile", (0.0, 1.5, math.nan, "most", None), r"quantile is {value}; expected .*\(0, 1\]"),
    *_of_policy(calibrate, "margin", (0.5, math.nan, math.inf, "wide"), "margin is {value}; expected .* at least 1"),
    *_of_policy(calibrate, "seed", (-1,), _WHOLE),
    *_of_policy(
        film, "episodes", (0, -1, 10**6, "all"), "{name} is {value}; expected a whole number", path=Path("never.mp4")
    ),
    *_of_policy(film, "path", (Path("film.avi"), Path("film")), "path.*{value}.*; expected .*mp4", episodes=1),
    BadInput(
        "a baseline that is not there",
        lambda: policy().make_baseline("random"),
        "baseline 'random' is unknown for ppt_push; expected one of",
    ),
    BadInput(
        "an option that is not there",
        lambda: policy().with_changes(p_mx=1.0),
        r"option 'p_mx' is unknown; expected one of .*'p_max'",
    ),
    BadInput("a policy without environments", lambda: policy().make_env(0), "num_envs is 0; expected"),
    BadInput(
        "a sweep of a task that has none",
        lambda: run_sweep([policy()], episodes=1, seed=0, report=Path("x")),
        "policies are of .'push'.; expected policies of one task",
    ),
    BadInput(
        "a sweep of nobody",
        lambda: run_sweep([], episodes=1, seed=0, report=Path("x")),
        r"policies are of \[\]; expected",
    ),
]


def _recipe(text: str) -> object:
    """A user's file with a recipe."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "own.py"
        path.write_text(text)
        return find_recipe(path)


_RECIPES = find_recipes(["push"])
_STUDIES = [
    *each(Study, "seeds", (0, -1, 2.5, "three", 10**9), _WHOLE, _RECIPES),
    *each(Study, "episodes", (0, math.nan, 10**12), _WHOLE, _RECIPES),
    *each(Study, "num_envs", (0, "all"), _WHOLE, _RECIPES),
    *each(Study, "eval_seed", (-1, 0.5), _WHOLE, _RECIPES),
    bad(Study, r"recipes.*\[\]; expected recipes of one task", []),
    bad(Study, "recipes are of the tasks .*'maze', 'push'.*; expected", [*_RECIPES, *find_recipes(["maze"])]),
    bad(Study, "recipes hold 'p'; expected recipes. Find them by name", "push"),
    BadInput(
        "a report of no run",
        lambda: run_study(Study(_RECIPES, results=Path("nowhere")), report_only=True),
        "no finished run under nowhere/runs; leave --report-only out",
    ),
    *each(find_recipe, "name", ("ppt_fly", "", "recipe.py"), "recipe {value} is unknown; expected one of .*ppt_push"),
    bad(find_recipe, "name is 7, of type int; expected str or Path", 7),
    bad(find_recipes, "recipe 'fly' is unknown; expected one of", ["push", "fly"]),
    *each(
        load_policy,
        "source",
        ("nothing", "no/where"),
        "(nothing|no/where) does not exist; expected a checkpoint or a run",
    ),
    bad(load_policy, "source is None, of type NoneType; expected str or Path", None),
    bad(load_policy, "recipe 'ppt_fly' is unknown", "ppt_push", recipe="ppt_fly"),
    *(
        BadInput(f"a recipe that {name}", partial(_recipe, text), match)
        for name, text, match in (
            ("is no Python", "def (", r"own.py cannot be run: SyntaxError: .*; expected a recipe"),
            ("imports what is not there", "import octopus", "own.py cannot be run: ModuleNotFoundError: .*'octopus'"),
            ("divides by zero", "1 / 0", "own.py cannot be run: ZeroDivisionError"),
            ("defines none", "x = 1", "own.py defines no recipe; expected RECIPE = Recipe"),
            ("defines another thing", "RECIPE = 'ppt_push'", "own.py defines no recipe; expected RECIPE = Recipe"),
        )
    ),
    bad(
        load_policy,
        "ppt_push is of variant 'ppt_push'; expected a recipe of it, and 's_push' makes",
        "ppt_push",
        recipe="s_push",
    ),
]
_NONE = np.zeros(0)
_STATISTICS = [
    bad(interval, "values are empty; expected at least one", _NONE, is_rate=True),
    bad(interval, "values are empty; expected at least one", _NONE, is_rate=False),
    bad(interval, "values are .*nan.*; expected finite numbers", np.asarray([1.0, math.nan]), is_rate=False),
    bad(interval, "values are .*0.5.*; expected zeros and ones", np.asarray([0.0, 0.5, 1.0]), is_rate=True),
    bad(summarise, r"rows lack \['success', .*; expected", {}),
    bad(distribution, r"rows lack \['work'\]; expected", {"max_power": np.ones(3)}, ["max_power", "work"]),
    bad(distribution, "values of work are empty; expected", {"work": _NONE}, ["work"]),
    bad(over_seeds, "values are empty; expected at least one", []),
    bad(judge, r"values lack \['ST'\]; expected", Claim("success", "PPT", "ST", True), {"PPT": [1.0]}),
    bad(judge, "values of 'ST' are empty; expected", Claim("success", "PPT", "ST", True), {"PPT": [1.0], "ST": []}),
    *each(moving_average, "window", (0, -2, 1.5, "wide"), _WHOLE, np.ones(3)),
    bad(as_csv, "rows are empty; expected at least one", []),
    bad(as_csv, r"row 1 has the keys \['b'\]; expected \['a'\]", [{"a": 1}, {"b": 1}]),
    bad(markdown, r"line 0 has 1 cells; expected 2", ["a", "b"], [["1"]]),
    bad(from_csv, "the text is empty; expected a line of names", ""),
    bad(from_csv, r"line 3 has 1 cells; expected 2", "a,b\n1,2\n3\n"),
    bad(from_csv, "'x'.* in line 2 .*; expected numbers", "a,b\n1,x\n"),
    *each(write_video, "fps", (0.0, math.nan, "fast"), "fps is {value}; expected", Path("never.mp4"), []),
]


def _scalar(name: str, match: str, data: bytes | None) -> BadInput:
    """A damaged log of a scalar; without data there is none."""

    def read() -> object:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "logs" / "csv" / "scalars" / "success.csv"
            if data is not None:
                path.parent.mkdir(parents=True)
                path.write_bytes(data)
            return read_scalar(Path(folder), "success")

    return BadInput(f"log of a scalar: {name}", read, match)


def _kept(name: str, match: str, files: Mapping[str, bytes], read: Callable[[KeptRun], object]) -> BadInput:
    """Damaged results of a run."""

    def make() -> object:
        with tempfile.TemporaryDirectory() as folder:
            for file, data in files.items():
                (Path(folder) / file).write_bytes(data)
            return read(KeptRun(_RECIPES[0], 0, Path(folder) / "run", Path(folder)))

    return BadInput(f"results: {name}", make, match)


_LOGS = [
    _scalar("never logged", "success.*(expected|Look|Train)", None),
    _scalar("empty", "success.csv.*expected", b""),
    _scalar("words", "success.csv.*expected", b"step,value\n1,high\n"),
    _scalar("a line without a value", "success.csv.*expected", b"1,0.5\n2\n"),
    _scalar("binary", "success.csv.*expected", bytes(range(256))),
    bad(plot_training, "success.*(expected|Look|Train)", Path("nowhere"), Path("never.png")),
    bad(curves_csv, "success.*(expected|Look|Train)", Path("nowhere")),
]
_RESULTS = [
    _kept("no evaluation", "evaluation.json cannot be read .*; expected", {}, KeptRun.evaluation),
    _kept("an empty evaluation", "evaluation.json cannot be read .*; expected", {"evaluation.json": b""},
          KeptRun.evaluation),
    _kept("half an evaluation", "evaluation.json cannot be read", {"evaluation.json": b'{"summary": {'},
          KeptRun.evaluation),
    _kept("another evaluation", "evaluation.json lacks .*'episodes'.*; expected", {"evaluation.json": b"{}"},
          KeptRun.evaluation),
    _kept("a list for an evaluation", "evaluation.json .*expected", {"evaluation.json": b"[1]"}, KeptRun.evaluation),
    _kept("no options", "config.json cannot be read .*; expected", {}, KeptRun.config),
    _kept("options without options", r"config.json lacks \['config'\]", {"config.json": b"{}"}, KeptRun.config),
    _kept("options of another version", "config.json was written by another version of .*speed.*; expected",
          {"config.json": b'{"config": {"speed": 1}}'}, KeptRun.config),
    _kept("no curves", "curves.csv cannot be read .*; expected", {}, KeptRun.curves),
    _kept("torn curves", "curves.csv cannot be read .*line 2 has 1 cells", {"curves.csv": b"a,b\n1"}, KeptRun.curves),
    _kept("binary curves", "curves.csv cannot be read", {"curves.csv": bytes(range(256))}, KeptRun.curves),
    _kept("no episodes", "episodes.csv.gz cannot be read", {}, KeptRun.episodes),
    _kept("episodes that are not compressed", "episodes.csv.gz cannot be read", {"episodes.csv.gz": b"a\n1\n"},
          KeptRun.episodes),
    _kept("torn episodes", "episodes.csv.gz cannot be read", {"episodes.csv.gz": gzip.compress(b"a\n1\n" * 99)[:-12]},
          KeptRun.episodes),
    _kept("no rollouts", "rollouts.npz cannot be read", {}, KeptRun.rollouts),
    _kept("rollouts that are no archive", "rollouts.npz cannot be read", {"rollouts.npz": b"PK"}, KeptRun.rollouts),
    _kept("empty rollouts", "rollouts.npz cannot be read", {"rollouts.npz": b""}, KeptRun.rollouts),
]  # fmt: skip

ENTRIES = [*_JUDGED, *_STUDIES, *_STATISTICS, *_LOGS, *_RESULTS]
