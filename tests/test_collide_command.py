"""The command ``ppt-rl collide``."""

import json
from types import SimpleNamespace

import pytest

from ppt_rl.collide_command import Collide


def test_the_last_line_is_json_and_the_tables_stand_before_it(capsys, tmp_path):
    Collide(
        ("pp_push",), scenario=("blocked",), episodes=2, seed=3, num_threads=1, json=True, report=tmp_path / "report",
        settings=("duration=1.5",),
    ).run()  # fmt: skip
    lines = capsys.readouterr().out.splitlines()
    report = json.loads(lines[-1])
    assert (report["scenario"], report["policy"], report["episodes"]) == ("blocked", "pp_push", 2)
    for name in ("peak_force", "static_force", "true_power", "true_work"):
        assert set(report[name]) == {"mean", "p95", "max"}
        assert report[name]["max"] > 0
    assert any(line.startswith("| blocked | pp_push |") for line in lines)
    assert (tmp_path / "report" / "collisions.png").is_file()


def test_policies_go_by_their_variants_and_those_of_one_variant_by_what_was_given(monkeypatch):
    variants = {"runs/a": "ppt_push", "runs/b": "ppt_push", "runs/c": "pp_push"}
    monkeypatch.setattr(
        "ppt_rl.collide_command._load", lambda name, recipe, settings: SimpleNamespace(variant=variants[name])
    )
    assert list(Collide(tuple(variants)).load()) == ["runs/a", "runs/b", "pp_push"]


def test_a_policy_may_be_given_once_and_one_must_be():
    with pytest.raises(ValueError, match=r"policies \['pp_push'\] are given more than once; expected different ones"):
        Collide(("pp_push", "pp_push")).load()
    with pytest.raises(ValueError, match="no policy is given; expected at least one"):
        Collide(()).load()
