"""Descriptions of mazes: a corridor as a list of straights, turns and discs."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, asdict, dataclass, fields
from pathlib import Path
from typing import Any

from ppt_rl.functional.argument_checks import require_instance, shown

__all__ = ["Disc", "MazeLayout", "Segment", "Straight", "Turn", "paper_layout"]


@dataclass(frozen=True)
class Straight:
    """A straight piece of corridor.

    Attributes:
        length: length on the map [m].
        rise: rise of the floor, on a ramp between two level ends [m].
    """

    length: float
    rise: float = 0.0

    def __post_init__(self) -> None:
        """Check the ranges."""
        _require_range("Straight.length", self.length, 0.02, 2.0, "m")
        _require_range("Straight.rise", self.rise, -0.1, 0.1, "m")


@dataclass(frozen=True)
class Turn:
    """A corner between two straights.

    Attributes:
        angle: change of direction, positive to the left [rad].
    """

    angle: float

    def __post_init__(self) -> None:
        """Check the ranges."""
        _require_range("Turn.angle", self.angle, -math.radians(75), math.radians(75), "rad")


@dataclass(frozen=True)
class Disc:
    """A round chamber, wider than the corridor: the walls recede on both sides, and the exit is opposite.

    Attributes:
        diameter: diameter of the chamber [m].
        angle: change of direction from entrance to exit, positive to the left [rad].
    """

    diameter: float
    angle: float = 0.0

    def __post_init__(self) -> None:
        """Check the ranges."""
        _require_range("Disc.diameter", self.diameter, 0.07, 0.3, "m")
        _require_range("Disc.angle", self.angle, -math.radians(60), math.radians(60), "rad")


Segment = Straight | Turn | Disc
#: More segments do not fit into any arm's reach.
_MOST_SEGMENTS = 100
#: What the JSON text of a layout looks like.
_FORM = "{'segments': [{'kind': 'straight', ...}]}"
_KINDS: dict[str, type[Segment]] = {"straight": Straight, "turn": Turn, "disc": Disc}


@dataclass(frozen=True)
class MazeLayout:
    """Description of a maze: a corridor from its closed start to its open end.

    Attributes:
        segments: straights, turns and discs in order. The first and the last are straights, and turns and discs have
            straights between them.
        width: distance between the walls [m].
        friction: friction coefficient between the tool and walls or floor [-].
        start: x and y of the beginning of the centre line [m].
        heading: direction of the first segment, counter-clockwise from the x axis [rad].
        height: height of the floor at the start, above the table [m].

    Raises:
        ValueError: if a number is out of range or the order of segments is impossible.
    """

    segments: tuple[Segment, ...]
    width: float = 0.055
    friction: float = 0.25
    start: tuple[float, float] = (0.45, -0.40)
    heading: float = math.pi / 2
    height: float = 0.0

    def __post_init__(self) -> None:
        """Check the ranges and the order of segments."""
        object.__setattr__(self, "segments", _as_tuple("segments", self.segments, "Straight, Turn and Disc"))
        object.__setattr__(self, "start", _as_tuple("start", self.start, "x and y [m]"))
        _require_range("width", self.width, 0.03, 0.2, "m")
        _require_range("friction", self.friction, 0.0, 1.0, "")
        _require_range("height", self.height, 0.0, 0.2, "m")
        _require_range("heading", self.heading, -2 * math.pi, 2 * math.pi, "rad")
        if len(self.segments) > _MOST_SEGMENTS:
            raise ValueError(f"the maze has {len(self.segments)} segments; expected at most {_MOST_SEGMENTS}.")
        if len(self.start) != 2:
            raise ValueError(f"start is {self.start}; expected x and y [m].")
        for value in self.start:
            if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
                raise ValueError(f"start is {self.start}; expected two finite numbers, x and y [m].")
            _require_range("a coordinate of start", value, -10.0, 10.0, "m")
        unknown = [part for part in self.segments if not isinstance(part, tuple(_KINDS.values()))]
        if unknown or not self.segments:
            raise ValueError(f"segments contain {unknown or 'nothing'}; expected Straight, Turn and Disc.")
        if not (isinstance(self.segments[0], Straight) and isinstance(self.segments[-1], Straight)):
            raise ValueError("segments begin or end with a turn or a disc; expected a Straight at both ends.")
        for first, second in zip(self.segments[:-1], self.segments[1:], strict=True):
            if not isinstance(first, Straight) and not isinstance(second, Straight):
                raise ValueError(f"{first} is followed by {second}; expected a Straight between them.")
            if isinstance(first, Straight) and isinstance(second, Straight):
                raise ValueError(f"{first} is followed by {second}; expected one Straight, or a Turn between them.")

    @property
    def is_straight(self) -> bool:
        """Whether the corridor has neither turns nor discs."""
        return all(isinstance(segment, Straight) for segment in self.segments)

    def to_json(self) -> str:
        """The layout as JSON text, for :meth:`from_json`."""
        names = {kind: name for name, kind in _KINDS.items()}
        data = asdict(self)
        data["segments"] = [{"kind": names[type(part)], **asdict(part)} for part in self.segments]
        return json.dumps(data, indent=2) + "\n"

    @classmethod
    def from_json(cls, text: str) -> MazeLayout:
        """Read a layout from JSON text.

        Args:
            text: an object with the attributes of the layout; each segment is an object with a ``kind`` (``straight``,
                ``turn`` or ``disc``) and the attributes of that kind.

        Returns:
            The layout.

        Raises:
            ValueError: if the text is not JSON, a name is unknown or missing, or a number is out of range.
        """
        require_instance("text", text, str)
        try:
            data = json.loads(text)
        except (json.JSONDecodeError, RecursionError) as error:
            raise ValueError(f"the layout is not valid JSON: {error}; expected {_FORM}.") from error
        if not isinstance(data, Mapping) or not isinstance(data.get("segments"), Sequence):
            raise ValueError(f"the layout has no list of segments; expected {_FORM}.")
        segments = tuple(_segment(part) for part in data["segments"])
        return _construct(cls, {**data, "segments": segments})

    @classmethod
    def load(cls, path: Path) -> MazeLayout:
        """Read a layout from a JSON file.

        Args:
            path: path of the file.

        Returns:
            The layout.

        Raises:
            ValueError: if the file cannot be read as text, and as for :meth:`from_json`.
        """
        require_instance("path", path, str, Path)
        try:
            text = Path(path).read_text(encoding="utf-8")
        except (OSError, ValueError) as error:
            raise ValueError(
                f"{path} cannot be read ({error}); expected a JSON file with the layout of a maze."
            ) from error
        try:
            return cls.from_json(text)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error


def paper_layout() -> MazeLayout:
    """A maze of about 1 m with every element that the paper names: turns of 20 to 45 degrees, a disc, 4 cm up and down.

    Returns:
        The layout.

    Source:
        Paper, section "Maze Sliding". The paper gives the ranges; the order of the elements is our choice.
    """
    degrees = math.radians
    return MazeLayout(
        segments=(
            Straight(0.12), Turn(degrees(-30)), Straight(0.19, rise=0.04), Turn(degrees(45)), Straight(0.11),
            Turn(degrees(20)), Straight(0.08), Disc(0.10), Straight(0.19, rise=-0.04), Turn(degrees(-45)),
            Straight(0.14), Turn(degrees(25)), Straight(0.10),
        ),
        width=0.055, start=(0.45, -0.45), heading=degrees(90),
    )  # fmt: skip


def _segment(part: Any) -> Segment:
    kind = part.get("kind") if isinstance(part, Mapping) else None
    if not isinstance(kind, str) or kind not in _KINDS:
        raise ValueError(f"segment {part} has kind {kind!r}; expected one of {sorted(_KINDS)}.")
    return _construct(_KINDS[kind], {name: value for name, value in part.items() if name != "kind"})


def _construct(kind: type[Any], data: Mapping[str, Any]) -> Any:
    known = [field.name for field in fields(kind)]
    unknown = sorted(set(data) - set(known))
    if unknown:
        raise ValueError(f"{kind.__name__} has no attribute {', '.join(unknown)}; expected names from {known}.")
    needed = [field.name for field in fields(kind) if field.default is MISSING]
    missing = [name for name in needed if name not in data]
    if missing:
        raise ValueError(f"{kind.__name__} has no {', '.join(missing)}; expected at least {needed}.")
    return kind(**data)


def _as_tuple(name: str, values: Any, expected: str) -> tuple[Any, ...]:
    if not isinstance(values, Iterable):
        raise ValueError(f"{name} is {shown(values)}; expected {expected}.")
    return tuple(values)


def _require_range(name: str, value: float, low: float, high: float, unit: str) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        expected = f"a number from {low:.4g} to {high:.4g} {unit}".rstrip()
        raise ValueError(f"{name} is {shown(value)}; expected {expected}.")
