"""Seeds of evaluated episodes: one, or several that share the episodes."""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["listed_seeds", "seeds_of"]


def seeds_of(seed: int | Sequence[int]) -> tuple[int, ...]:
    """Seeds of evaluated episodes, given as one number or several different ones.

    Args:
        seed: a seed, or several.

    Returns:
        The seeds.

    Raises:
        ValueError: if there is none, or one comes twice.
    """
    seeds = tuple(seed) if isinstance(seed, Sequence) and not isinstance(seed, str) else (seed,)
    if not seeds or len(set(seeds)) < len(seeds):
        raise ValueError(f"the seeds of the episodes are {list(seeds)}; expected at least one, each of them once.")
    return seeds


def listed_seeds(seed: int | Sequence[int]) -> str:
    """Seeds of evaluated episodes as text.

    Args:
        seed: a seed, or several.

    Returns:
        Them, separated by commas.
    """
    return ", ".join(map(str, seeds_of(seed)))
