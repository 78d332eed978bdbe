"""Tables, JSON and the figure of the collision benchmark, from rows that are made up."""

import json
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

from ppt_rl.evaluation import Collisions, Scenario, collide, load_policy
from ppt_rl.evaluation.collision_figure import _draw_bars, plot_collisions
from ppt_rl.evaluation.collisions import QUANTITIES, scenarios_of
from ppt_rl.evaluation.disturbed import _with_spring_energy
from ppt_rl.evaluation.limits import LIMITS, shares_above

EPISODES = 8
SCENARIOS = [
    Scenario("wall", "a wall", make_env=lambda *args, **kwargs: None),
    Scenario("hand", "a hand", make_env=lambda *args, **kwargs: None, kinds=("clamped", "free")),
]


def made_up(policies=("one",), scenarios=SCENARIOS):
    """Rows in which peak and static force count up from 100 N and 60 N in steps of 10 N."""
    steps = 10.0 * np.arange(EPISODES)
    rows = dict.fromkeys(QUANTITIES, steps) | {
        "peak_force": 100 + steps, "static_force": 60 + steps, "success": np.zeros(EPISODES),
        "contact": np.ones(EPISODES), "kind": np.arange(EPISODES) % 2.0,
    }  # fmt: skip
    return Collisions(
        scenarios,
        {policy: {scenario.name: rows for scenario in scenarios} for policy in policies},
        {policy: policy.upper() for policy in policies},
    )


def test_the_json_of_one_policy_in_one_scenario_has_the_promised_form():
    report = json.loads(json.dumps(made_up(scenarios=SCENARIOS[:1]).as_json()))
    for name in ("peak_force", "static_force", "true_power", "true_work", "spring_energy", "pressure_force"):
        assert set(report[name]) == {"mean", "p95", "max"}
        assert report[name]["mean"] <= report[name]["p95"] <= report[name]["max"]
    assert report["peak_force"] == {"mean": 135.0, "p95": pytest.approx(166.5), "max": 170.0}
    assert (report["scenario"], report["policy"], report["episodes"], report["success"]) == ("wall", "one", 8, 0.0)


def test_the_json_of_more_is_by_policy_and_scenario():
    assert list(made_up().as_json()) == ["wall", "hand"]
    both = made_up(("one", "two")).as_json()
    assert list(both) == ["one", "two"]
    assert list(both["two"]) == ["wall", "hand"]
    assert list(made_up(("one", "two"), SCENARIOS[:1]).as_json()) == ["one", "two"]


def test_kinds_of_episodes_are_reported_on_their_own():
    hand = made_up().as_json()["hand"]
    assert hand["episodes"] == 8
    assert [hand["kinds"][kind]["episodes"] for kind in ("clamped", "free")] == [4, 4]
    assert hand["kinds"]["clamped"]["peak_force"]["max"] == 160.0
    assert hand["kinds"]["free"]["peak_force"]["max"] == 170.0


def test_shares_above_the_limits_count_episodes():
    report = made_up(scenarios=SCENARIOS[:1]).as_json()["above_limits"]
    assert report["face"] == {"quasi_static": 7 / 8, "transient": 4 / 8}  # above 65 N and above 130 N
    assert report["abdomen"] == {"quasi_static": 2 / 8, "transient": 0.0}  # above 110 N and above 220 N
    assert report["hand"] == {"quasi_static": 0.0, "transient": 0.0}  # above 140 N and above 280 N
    exactly = shares_above(static=np.asarray([65.0]), peak=np.asarray([130.0]))
    assert exactly["face"] == {"quasi_static": 0.0, "transient": 0.0}
    nothing = shares_above(static=np.zeros(0), peak=np.zeros(0))
    assert set(nothing) == set(LIMITS)


def test_one_episode_leaves_a_kind_without_any_and_is_reported():
    rows = {name: values[:1] for name, values in made_up().rows["one"]["hand"].items()}
    result = Collisions(SCENARIOS[1:], {"one": {"hand": rows}}, {"one": "ONE"})
    assert result.as_json()["kinds"]["free"]["episodes"] == 0
    assert "hand, free" in result.tables()


def test_a_report_has_tables_every_episode_and_a_figure(tmp_path):
    result = made_up(("one", "two"))
    result.write(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"collisions.md", "collisions.json", "collisions.png"}
    table = (tmp_path / "collisions.md").read_text()
    assert "| hand, free | two |" in table
    assert "135.0 / 166.5 / 170.0" in table
    stored = json.loads((tmp_path / "collisions.json").read_text())
    assert [(entry["policy"], entry["scenario"]) for entry in stored] == [
        ("one", "wall"), ("one", "hand"), ("two", "wall"), ("two", "hand"),
    ]  # fmt: skip
    assert [episode["peak_force"] for episode in stored[0]["every_episode"]] == list(100 + 10.0 * np.arange(EPISODES))


@pytest.mark.parametrize("count", [1, 4, 7])
def test_no_bar_of_the_figure_overlaps_another(count, tmp_path):
    policies = tuple(f"p{number}" for number in range(count))
    groups = {name: {p: rows["peak_force"] for p, rows in found.items()} for name, found in made_up(policies).groups()}
    axes = Figure().subplots()
    _draw_bars(axes, groups)
    spans = sorted((bar.get_x(), bar.get_x() + bar.get_width()) for bar in axes.patches)
    assert len(spans) == 3 * count
    assert all(right <= left for (_, right), (left, _) in pairwise(spans))
    plot_collisions(dict(made_up(policies).groups()), tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 1000


def _of_task(name, scenarios=()):
    return SimpleNamespace(recipe=SimpleNamespace(task=SimpleNamespace(name=name, scenarios=scenarios)))


def test_policies_without_scenarios_of_several_tasks_and_unknown_names_are_refused():
    push, other = _of_task("push", SCENARIOS), _of_task("wipe", SCENARIOS)
    assert scenarios_of({"a": push}, ["hand"]) == SCENARIOS[1:]
    assert scenarios_of({"a": push}) == SCENARIOS
    with pytest.raises(
        ValueError, match="m is a policy of the task 'maze', which has no collision scenarios; expected"
    ):
        scenarios_of({"a": push, "m": _of_task("maze")})
    with pytest.raises(ValueError, match=r"the tasks \['push', 'wipe'\]; expected policies of one task"):
        scenarios_of({"a": push, "b": other})
    with pytest.raises(ValueError, match=r"scenario 'crash' is unknown; expected one of \['wall', 'hand'\]"):
        scenarios_of({"a": push}, ["crash"])
    with pytest.raises(ValueError, match="no policy is given; expected at least one"):
        scenarios_of({})


def test_a_coarse_time_step_and_no_episode_are_refused():
    policy = load_policy("ppt_push")
    with pytest.raises(ValueError, match="episodes is 0; expected"):
        collide({"ppt": policy}, episodes=0)
    with pytest.raises(ValueError, match=r"physics_dt is 0.001 s; expected at most 0.0005 s"):
        collide({"ppt": policy.with_changes(physics_dt=0.001)}, scenarios=("blocked",), episodes=1)


def test_a_chain_without_an_impedance_is_refused():
    with pytest.raises(ValueError, match="the chain of bare has no impedance controller; expected an Impedance"):
        _with_spring_energy([], "bare")
