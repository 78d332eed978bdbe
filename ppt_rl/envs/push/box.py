"""The boxes of the pushing task: their sizes and masses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ppt_rl.envs.limits import Bound, require_within
from ppt_rl.functional.argument_checks import shown

__all__ = ["NOMINAL_MASSES", "Boxes"]

#: Nominal mass [kg] of a box by its edge length [m] (paper, section "Box Pushing").
NOMINAL_MASSES = {0.06: 0.050, 0.08: 0.080}
#: A box is higher than the lower edge of the tool and shorter than the tool's way to it; an arm can push that much.
_SIZE: Bound = (0.03, 0.2, "m")
_MASS: Bound = (0.01, 3.0, "kg")


@dataclass(frozen=True)
class Boxes:
    """Boxes to draw from.

    Attributes:
        sizes: edge lengths [m].
        masses: nominal mass of each [kg].
    """

    sizes: tuple[float, ...]
    masses: tuple[float, ...]

    @classmethod
    def of(cls, sizes: Sequence[float], masses: Sequence[float] | None = None) -> Boxes:
        """Boxes of given sizes.

        Args:
            sizes: edge lengths [m].
            masses: mass of each [kg]; None takes the paper's.

        Returns:
            The boxes.

        Raises:
            ValueError: if there is no box, a number is out of range, or a mass is missing.
        """
        if not isinstance(sizes, Sequence) or isinstance(sizes, str):
            raise ValueError(f"box_sizes is {shown(sizes)}; expected a sequence of one edge length or more [m].")
        if not sizes:
            raise ValueError("box_sizes is empty; expected one edge length or more [m].")
        for size in sizes:
            require_within("an entry of box_sizes", size, _SIZE)
        if masses is None:
            unknown = [size for size in sizes if size not in NOMINAL_MASSES]
            if unknown:
                raise ValueError(
                    f"box_sizes has {unknown} without a nominal mass; expected sizes among {list(NOMINAL_MASSES)} m. "
                    "For other boxes pass box_masses too, one mass for each size [kg]."
                )
            masses = [NOMINAL_MASSES[size] for size in sizes]
        if len(masses) != len(sizes):
            raise ValueError(
                f"box_masses are {tuple(masses)}; expected {len(sizes)}, one for each size {tuple(sizes)}."
            )
        for mass in masses:
            require_within("an entry of box_masses", mass, _MASS)
        return cls(tuple(map(float, sizes)), tuple(map(float, masses)))
