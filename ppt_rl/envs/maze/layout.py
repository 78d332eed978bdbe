"""Descriptions of mazes: a corridor as a list of straights, turns and discs."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

__all__ = ["Disc", "MazeLayout", "Segment", "Straight", "Turn", "paper_layout"]


@dataclass(frozen=True)
class Straight:
    """A straight piece of corridor.

    Attributes:
        length: along the centre line, on the map [m].
        rise: of the floor, on a ramp between two level ends [m].
    """

    length: float
    rise: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what cannot be built."""
        _require_range("Straight.length", self.length, 0.02, 2.0, "m")
        _require_range("Straight.rise", self.rise, -0.1, 0.1, "m")


@dataclass(frozen=True)
class Turn:
    """A corner between two straights.

    Attributes:
        angle: positive to the left [rad].
    """

    angle: float

    def __post_init__(self) -> None:
        """Refuse what cannot be built."""
        _require_range("Turn.angle", self.angle, -math.radians(75), math.radians(75), "rad")


@dataclass(frozen=True)
class Disc:
    """A round chamber: the walls give way on both sides, and the way on is across.

    Attributes:
        diameter: [m].
        angle: by which the way out is turned against the way in, positive to the left [rad].
    """

    diameter: float
    angle: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what cannot be built."""
        _require_range("Disc.diameter", self.diameter, 0.07, 0.3, "m")
        _require_range("Disc.angle", self.angle, -math.radians(60), math.radians(60), "rad")


Segment = Straight | Turn | Disc
_KINDS: dict[str, type[Segment]] = {"straight": Straight, "turn": Turn, "disc": Disc}


@dataclass(frozen=True)
class MazeLayout:
    """A corridor, from its closed start to its open end.

    Attributes:
        segments: in order; the first and the last are straight, and so is what stands beside a turn or a disc.
        width: between the walls [m].
        friction: of walls and floor on the tool [-].
        start: x and y where the centre line begins [m].
        heading: of the first segment, from the x axis to the left [rad].
        height: of the floor at the start, above the table [m].

    Raises:
        ValueError: if a number is out of range or the order is impossible.
    """

    segments: tuple[Segment, ...]
    width: float = 0.055
    friction: float = 0.25
    start: tuple[float, float] = (0.45, -0.40)
    heading: float = math.pi / 2
    height: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what cannot be built."""
        object.__setattr__(self, "segments", tuple(self.segments))
        object.__setattr__(self, "start", tuple(self.start))
        _require_range("width", self.width, 0.03, 0.2, "m")
        _require_range("friction", self.friction, 0.0, 1.0, "")
        _require_range("height", self.height, 0.0, 0.2, "m")
        _require_range("heading", self.heading, -2 * math.pi, 2 * math.pi, "rad")
        if len(self.start) != 2:
            raise ValueError(f"start is {self.start}; expected x and y [m].")
        for value in self.start:
            if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
                raise ValueError(f"start is {self.start}; expected two finite numbers, x and y [m].")
        strange = [part for part in self.segments if not isinstance(part, tuple(_KINDS.values()))]
        if strange or not self.segments:
            raise ValueError(f"segments hold {strange or 'nothing'}; expected Straight, Turn and Disc.")
        if not (isinstance(self.segments[0], Straight) and isinstance(self.segments[-1], Straight)):
            raise ValueError("segments begin or end with a turn or a disc; expected a Straight there.")
        for first, second in zip(self.segments[:-1], self.segments[1:], strict=True):
            if not isinstance(first, Straight) and not isinstance(second, Straight):
                raise ValueError(f"{first} stands beside {second}; expected a Straight between them.")
            if isinstance(first, Straight) and isinstance(second, Straight):
                raise ValueError(f"{first} stands beside {second}; expected one Straight, or a Turn between them.")

    @property
    def is_straight(self) -> bool:
        """Whether there is nothing to turn at."""
        return all(isinstance(segment, Straight) for segment in self.segments)

    def to_json(self) -> str:
        """The layout as JSON text, which :meth:`from_json` reads back."""
        names = {kind: name for name, kind in _KINDS.items()}
        data = asdict(self)
        data["segments"] = [{"kind": names[type(part)], **asdict(part)} for part in self.segments]
        return json.dumps(data, indent=2) + "\n"

    @classmethod
    def from_json(cls, text: str) -> MazeLayout:
        """Read a layout.

        Args:
            text: JSON: the attributes by name; each segment has a ``kind`` (``straight``, ``turn``, ``disc``) and its
                own attributes.

        Returns:
            The layout.

        Raises:
            ValueError: if it is no JSON, a name is unknown or missing, or a number is out of range.
        """
        try:
            data = json.loads(text)
        except json.JSONDecodeError as error:
            raise ValueError(f"the layout is no JSON ({error}).") from error
        if not isinstance(data, Mapping) or not isinstance(data.get("segments"), Sequence):
            raise ValueError("the layout has no list of segments; expected {'segments': [{'kind': 'straight', ...}]}.")
        segments = tuple(_segment(part) for part in data["segments"])
        return _built(cls, {**data, "segments": segments})

    @classmethod
    def load(cls, path: Path) -> MazeLayout:
        """Read a layout from a JSON file.

        Args:
            path: of the file.

        Returns:
            The layout.

        Raises:
            ValueError: as :meth:`from_json`.
        """
        return cls.from_json(Path(path).read_text())


def paper_layout() -> MazeLayout:
    """A maze with every element the paper names: turns of 20 to 45 degrees, a disc, 4 cm up and down, about 1 m long.

    Returns:
        The layout.

    Source:
        Paper, section "Maze Sliding"; the paper gives ranges, the order is ours.
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
    return _built(_KINDS[kind], {name: value for name, value in part.items() if name != "kind"})


def _built(kind: type[Any], data: Mapping[str, Any]) -> Any:
    known = [field.name for field in fields(kind)]
    unknown = sorted(set(data) - set(known))
    if unknown:
        raise ValueError(f"{kind.__name__} has no {', '.join(unknown)}; expected names out of {known}.")
    try:
        return kind(**data)
    except TypeError as error:
        raise ValueError(f"{kind.__name__} from {dict(data)}: {error}.") from error


def _require_range(name: str, value: float, low: float, high: float, unit: str) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise ValueError(f"{name} is {value}; expected a number from {low:.4g} to {high:.4g} {unit}".rstrip() + ".")
