"""Bad descriptions of mazes: objects, JSON text and files."""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from ppt_rl.envs import Disc, MazeEnv, MazeLayout, Straight, Turn
from tests.bad_inputs.entry import BadInput, bad, each

__all__ = ["ENTRIES"]

_RANGE = "{name} is {value}; expected a (finite )?number from"
_GOOD: dict[str, Any] = {"segments": [{"kind": "straight", "length": 0.3}], "start": [0.4, -0.1]}


def _layout(match: str, pending: bool = False, **changes: Any) -> BadInput:
    """A layout of one straight with other attributes."""
    text = json.dumps(_GOOD | changes)
    return BadInput(f"layout {json.dumps(changes)[:90]}", partial(MazeLayout.from_json, text), match, pending)


def _text(name: str, match: str, text: Any, pending: bool = False) -> BadInput:
    return BadInput(f"layout: {name}", partial(MazeLayout.from_json, text), match, pending)


def _segments(match: str, *parts: Any, pending: bool = False) -> BadInput:
    return _layout(match, pending, segments=list(parts))


def _file(name: str, match: str, data: bytes | None, pending: bool = False) -> BadInput:
    """A file with this content; a folder where the content is None."""

    def load() -> MazeLayout:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "maze.json"
            if data is not None:
                path.write_bytes(data)
            return MazeLayout.load(path if data is not None else path.parent)

    return BadInput(f"file of a layout: {name}", load, match, pending)


def _build(name: str, match: str, parts: Sequence[Any], pending: bool = False, **changes: Any) -> BadInput:
    """A maze that no tool can drive through."""
    return BadInput(
        f"maze: {name}",
        lambda: MazeEnv.of([MazeLayout(tuple(parts), **{"start": (0.45, -0.15), **changes})]),
        match,
        pending,
    )


_LONG = {"kind": "straight", "length": 0.3}
_PARTS = [
    *each(
        Straight, "length", (0.0, -0.3, math.nan, math.inf, 1e9, "long", None, True), r"Straight.length is .*; expected"
    ),
    *each(Straight, "rise", (0.5, math.nan, "up"), "Straight.rise is .*; expected a (finite )?number", length=0.3),
    *each(Turn, "angle", (1.4, -1.4, math.nan, "left", None), "Turn.angle is .*; expected a (finite )?number"),
    *each(Disc, "diameter", (0.0, 3.0, math.nan), "Disc.diameter is .*; expected a (finite )?number"),
    *each(Disc, "angle", (2.0, "left"), "Disc.angle is .*; expected a (finite )?number", diameter=0.1),
    bad(MazeLayout, "segments.*; expected", None),
    bad(MazeLayout, "segments.*0.3.*; expected", 0.3),
    bad(MazeLayout, "segments contain nothing; expected Straight, Turn and Disc", ()),
    bad(MazeLayout, r"segments contain \['straight'\]; expected", ("straight",)),
    bad(MazeLayout, "start.*0.4.*; expected", (Straight(0.3),), start=0.4),
]
_JSON = [
    _text("empty", "not valid JSON.*expected", ""),
    _text("truncated", "not valid JSON.*expected", json.dumps(_GOOD)[:-9]),
    _text("a list", "no list of segments; expected", "[]"),
    _text("a number", "no list of segments; expected", "3"),
    _text("null", "no list of segments; expected", "null"),
    _text("text for segments", "segment '?s'? .*; expected|no list of segments; expected",
          json.dumps(_GOOD | {"segments": "straight"})),
    _text("no text at all", "text.*expected|layout.*expected", None),
    _text("nested without end", "layout.*(expected|Repair)", "[" * 100_000),
    _layout(r"segments contain nothing; expected", segments=[]),
    _layout("no list of segments; expected", segments=None),
    _layout("no list of segments; expected", segments={"kind": "straight"}),
    _layout("no list of segments; expected", segments=7),
    _layout("MazeLayout has no attribute colour; expected names from", colour="red"),
    _layout("width is '0.055'.*; expected a (finite )?number from 0.03 to 0.2 m", width="0.055"),
    _layout("width is nan; expected", width=math.nan),
    _layout("width is -0.05; expected", width=-0.05),
    _layout("width is None; expected", width=None),
    _layout(r"width is \[0.05\]; expected", width=[0.05]),
    _layout("friction is 1.5; expected a (finite )?number from 0 to 1", friction=1.5),
    _layout("friction is True; expected", friction=True),
    _layout("height is inf; expected a (finite )?number from 0 to 0.2 m", height=math.inf),
    _layout("height is -0.01; expected", height=-0.01),
    _layout("heading is 90; expected a (finite )?number from -6.283 to 6.283 rad", heading=90),
    _layout("heading is '?north'?; expected", heading="north"),
    _layout(r"start is \(0.4,\); expected x and y", start=[0.4]),
    _layout(r"start is \(0.4, nan\); expected two finite numbers", start=[0.4, math.nan]),
    _layout(r"start is \('x', 'y'\); expected two finite numbers", start=["x", "y"]),
    _layout("start.*None.*; expected", start=None),
    _segments("segment 7 has kind None; expected one of", 7),
    _segments(r"segment \{'length': 0.3\} has kind None; expected one of", {"length": 0.3}),
    _segments("has kind 'loop'; expected one of .*'disc', 'straight', 'turn'", {"kind": "loop"}),
    _segments(r"has kind \['turn'\]; expected one of", {"kind": ["turn"]}),
    _segments("Straight has no attribute width; expected names from", {**_LONG, "width": 0.05}),
    _segments("Straight.*(length).*(expected|missing)", {"kind": "straight"}),
    _segments("Straight.length is '0.3'; expected", {"kind": "straight", "length": "0.3"}),
    _segments("Straight.length is nan; expected", {"kind": "straight", "length": math.nan}),
    _segments("segments begin or end with a turn or a disc; expected a Straight", {"kind": "turn", "angle": 0.3}),
    _segments("Straight.* is followed by Straight.*; expected one Straight", _LONG, _LONG),
    _segments("Turn.* is followed by Turn.*; expected a Straight between", _LONG, {"kind": "turn", "angle": 0.3},
              {"kind": "turn", "angle": 0.3}, _LONG),
]  # fmt: skip
_FILES = [
    _file("empty", "maze.json.*(expected|Repair)", b""),
    _file("truncated", "maze.json.*(expected|Repair)", json.dumps(_GOOD).encode()[:-4]),
    _file("binary", "maze.json.*(expected|Repair)", bytes(range(256))),
    _file("another encoding", "maze.json.*(expected|Repair)", json.dumps(_GOOD).encode("utf-16")),
    _file("a folder", "(cannot be read|folder|directory).*(expected|Pass)", None),
    bad(MazeLayout.load, "nowhere/maze.json.*(expected|Pass)", Path("nowhere/maze.json")),
    bad(MazeLayout.load, "path.*7.*(expected|Pass)|7.*expected", 7),
]
_TURN = Turn(math.radians(60))
_BUILT = [
    _build("out of reach", "the maze lies .* m from the base; expected 0.3 to 0.7 m", [Straight(1.9)]),
    _build("behind the arm", "the maze lies .* from the base; expected", [Straight(0.2)], start=(-0.5, -0.1)),
    _build("a ramp too steep", "rise|ramp", [Straight(0.1, rise=0.1)], start=(0.45, -0.05)),
    _build("a ramp without room for level ends", "Straight.*rise.*expected|ramp", [Straight(0.06, rise=0.02)]),
    _build("a floor below the table", "below the table top; expected 0 m or more. Raise",
           [Straight(0.3, rise=-0.03)]),
    _build("a first piece too short to start in", "the first segment is .*; expected a length of at least",
           [Straight(0.04), Turn(0.1), Straight(0.2)]),
    _build("a disc narrower than its corridor", "Disc.diameter is 0.07 m in a corridor .* wide; expected a wider disc",
           [Straight(0.1), Disc(0.07), Straight(0.1)], width=0.08),
    _build("crossing itself", "(crosses itself|two stretches of the maze meet|a wall is|a wall has no length)",
           [Straight(0.14), _TURN, Straight(0.06), _TURN, Straight(0.06), _TURN, Straight(0.06), _TURN, Straight(0.3)]),
    _build("more pieces than the model has room for", "(the maze has .* pieces|segments).*; expected at most",
           [part for _ in range(15) for part in (Straight(0.02), Turn(0.001), Straight(0.02), Turn(-0.001))]
           + [Straight(0.02)], start=(0.45, -0.3)),
    _build("a hundred thousand pieces", "(the maze has .* pieces|segments).*; expected at most",
           [part for _ in range(50_000) for part in (Straight(0.02), Turn(0.001))] + [Straight(0.02)]),
]  # fmt: skip

ENTRIES = [*_PARTS, *_JSON, *_FILES, *_BUILT]
