from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ppt_rl.arms import PANDA
from ppt_rl.envs.maze.feasibility import check_corridor
from ppt_rl.envs.maze.geometry import build_corridor
from ppt_rl.envs.maze.layout import Disc, MazeLayout, Segment, Straight, Turn, paper_layout
from ppt_rl.functional.argument_checks import shown

STRAIGHT = {"kind": "straight", "length": 0.3}


def text(*segments: Any, **attributes: Any) -> str:
    return json.dumps({"segments": segments, **attributes})


@st.composite
def layouts(draw: st.DrawFn) -> MazeLayout:
    """Layouts with every kind of segment, most of which are not feasible."""
    straights = st.builds(Straight, st.floats(0.02, 2.0), st.floats(-0.1, 0.1))
    corners = st.builds(Turn, st.floats(-1.3, 1.3)) | st.builds(Disc, st.floats(0.07, 0.3), st.floats(-1.0, 1.0))
    segments: list[Segment] = [draw(straights)]
    for corner in draw(st.lists(corners, max_size=4)):
        segments += [corner, draw(straights)]
    coordinate = st.floats(-1.0, 1.0)
    return MazeLayout(
        tuple(segments),
        width=draw(st.floats(0.03, 0.2)),
        friction=draw(st.floats(0.0, 1.0)),
        start=draw(st.tuples(coordinate, coordinate)),
        heading=draw(st.floats(-6.0, 6.0)),
        height=draw(st.floats(0.0, 0.2)),
    )


# -- JSON --------------------------------------------------------------------------------------------------------------


@settings(max_examples=40, deadline=None, derandomize=True)
@given(layouts())
def test_writing_and_reading_a_layout_gives_exactly_the_same_layout(layout: MazeLayout) -> None:
    read = MazeLayout.from_json(layout.to_json())
    assert read == layout
    assert hash(read) == hash(layout)


def test_a_layout_is_read_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "maze.json"
    path.write_text(paper_layout().to_json())
    assert MazeLayout.load(path) == paper_layout()


def test_attributes_missing_from_a_file_have_their_defaults() -> None:
    assert MazeLayout.from_json(text(STRAIGHT)) == MazeLayout((Straight(0.3),))
    assert MazeLayout.from_json(text(STRAIGHT, width=0.05)) == MazeLayout((Straight(0.3),), width=0.05)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("{", r"the layout is not valid JSON: .*\."),
        ("[]", r"the layout has no list of segments; expected \{'segments'"),
        ('{"width": 0.05}', r"the layout has no list of segments; expected \{'segments'"),
        ('{"segments": 3}', r"the layout has no list of segments; expected \{'segments'"),
        (text("straight"), r"has kind None; expected one of \['disc', 'straight', 'turn'\]\."),
        (text({"length": 0.3}), r"has kind None; expected one of \['disc', 'straight', 'turn'\]\."),
        (text({"kind": "bend"}), r"has kind 'bend'; expected one of \['disc', 'straight', 'turn'\]\."),
        (text({"kind": ["straight"]}), r"expected one of \['disc', 'straight', 'turn'\]\."),
        (
            text({**STRAIGHT, "angle": 1}),
            r"Straight has no attribute angle; expected names from \['length', 'rise'\]",
        ),
        (text(STRAIGHT, with_="x", widht=1), r"MazeLayout has no attribute widht, with_; expected names from"),
        (text({"kind": "straight"}), r"Straight has no length; expected at least \['length'\]\."),
        (text({"kind": "straight", "length": 9}), r"Straight.length is 9; expected a number from 0.02 to 2 m\."),
        (text(STRAIGHT, start=3), r"start is 3; expected x and y \[m\]\."),
        (text(STRAIGHT, start=[1, 2, 3]), r"start is \(1, 2, 3\); expected x and y \[m\]\."),
    ],
)
def test_text_that_is_not_a_layout_is_refused_with_the_reason(given: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        MazeLayout.from_json(given)


# -- numbers and order -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [math.nan, math.inf, -9.0, 9.0, True, "0.1", None])
@pytest.mark.parametrize(
    ("kind", "name", "rest"),
    [
        (Straight, "length", {}),
        (Straight, "rise", {"length": 0.1}),
        (Turn, "angle", {}),
        (Disc, "diameter", {}),
        (Disc, "angle", {"diameter": 0.1}),
        (MazeLayout, "width", {"segments": (Straight(0.1),)}),
        (MazeLayout, "friction", {"segments": (Straight(0.1),)}),
        (MazeLayout, "heading", {"segments": (Straight(0.1),)}),
        (MazeLayout, "height", {"segments": (Straight(0.1),)}),
    ],
)
def test_a_value_outside_its_range_is_refused_with_the_range(
    kind: type[Any], name: str, rest: dict[str, Any], value: Any
) -> None:
    with pytest.raises(ValueError, match=rf"{name} is {shown(value)}; expected a number from .* to .*\.$"):
        kind(**rest, **{name: value})


@pytest.mark.parametrize("start", [("a", "b"), (math.nan, 0.0), (0.4, math.inf), (True, 0.0), (0.4,)])
def test_a_start_that_is_not_a_point_is_refused(start: tuple[Any, ...]) -> None:
    with pytest.raises(ValueError, match=r"start is .*; expected"):
        MazeLayout((Straight(0.3),), start=start)


@pytest.mark.parametrize(
    ("segments", "message"),
    [
        ((), r"segments contain nothing; expected Straight, Turn and Disc\."),
        ((Straight(0.3), 0.5), r"segments contain \[0.5\]; expected Straight, Turn and Disc\."),
        (
            (Turn(0.5), Straight(0.3)),
            r"segments begin or end with a turn or a disc; expected a Straight at both ends",
        ),
        (
            (Straight(0.3), Disc(0.1)),
            r"segments begin or end with a turn or a disc; expected a Straight at both ends",
        ),
        (
            (Straight(0.3), Turn(0.5), Disc(0.1), Straight(0.3)),
            r"Turn.* is followed by Disc.*a Straight between them",
        ),
        (
            (Straight(0.3), Turn(0.5), Turn(0.5), Straight(0.3)),
            r"Turn.* is followed by Turn.*a Straight between them",
        ),
        ((Straight(0.3), Straight(0.3)), r"Straight.* is followed by Straight.*one Straight, or a Turn between them"),
    ],
)
def test_an_impossible_order_of_segments_is_refused(segments: tuple[Any, ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        MazeLayout(segments)


def test_only_a_layout_without_turns_and_discs_is_straight() -> None:
    assert MazeLayout((Straight(0.3, rise=0.02),)).is_straight
    for corner in (Turn(0.3), Disc(0.1)):
        assert not MazeLayout((Straight(0.3), corner, Straight(0.3))).is_straight


def test_a_layout_from_lists_equals_one_from_tuples() -> None:
    lists: dict[str, Any] = {"segments": [Straight(0.3)], "start": [0.4, 0.1]}
    assert MazeLayout(**lists) == MazeLayout((Straight(0.3),), start=(0.4, 0.1))


# -- the maze of the paper ---------------------------------------------------------------------------------------------


def test_the_papers_maze_has_every_element_that_the_paper_names() -> None:
    layout = paper_layout()
    turns = [abs(math.degrees(part.angle)) for part in layout.segments if isinstance(part, Turn)]
    rises = [part.rise for part in layout.segments if isinstance(part, Straight) and part.rise]
    assert min(turns) == pytest.approx(20)
    assert max(turns) == pytest.approx(45)
    assert {part.angle > 0 for part in layout.segments if isinstance(part, Turn)} == {True, False}
    assert sum(isinstance(part, Disc) for part in layout.segments) == 1
    assert rises == [0.04, -0.04]
    assert build_corridor(layout).length == pytest.approx(1.0, abs=0.05)


def test_the_papers_maze_is_feasible_at_both_ends_of_the_range_of_widths() -> None:
    for width in (0.05, 0.06):
        layout = replace(paper_layout(), width=width)
        check_corridor(build_corridor(layout), layout, PANDA.reach)
