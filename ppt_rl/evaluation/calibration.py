"""Limits of an energy tank from a policy that has none: the power and the work it takes."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ppt_rl.evaluation.episodes import Rows, require_run_options, run_episodes
from ppt_rl.evaluation.figures import plot_calibration
from ppt_rl.evaluation.policy import Policy
from ppt_rl.evaluation.tables import markdown
from ppt_rl.functional.argument_checks import require_number
from ppt_rl.training.logs import write_text_atomically

__all__ = ["Calibration", "calibrate"]

#: A limit that no robot reaches, so that the tank never closes [W, J].
_NO_LIMIT = 1e6
_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.9, 0.95, 0.99, 1.0)
_QUANTITIES = {"max_power": "W", "work": "J", "audit_commanded_power": "W", "audit_commanded_work": "J"}


@dataclass(frozen=True)
class Calibration:
    """Power and work of a policy without limits, and the limits proposed from them.

    Attributes:
        policy: the policy.
        rows: a value an episode for every metric.
        quantile: share of the successful episodes that the limits would leave untouched [0-1].
        margin: factor on that quantile [-].
    """

    policy: Policy
    rows: Rows
    quantile: float
    margin: float

    @property
    def successful(self) -> int:
        """Number of episodes that succeeded."""
        return int((self.rows["success"] > 0.5).sum())

    def proposal(self) -> dict[str, float]:
        """``p_max`` [W] and ``e_max`` [J]: of successful episodes, or of all where none succeeded."""
        chosen = self.rows["success"] > 0.5 if self.successful else np.ones(len(self.rows["success"]), dtype=bool)
        return {
            limit: self.margin * float(np.quantile(self.rows[quantity][chosen], self.quantile))
            for limit, quantity in (("p_max", "max_power"), ("e_max", "work"))
        }

    def as_json(self) -> dict[str, Any]:
        """Proposal and quantiles as plain data."""
        quantiles = {key: {f"{q:g}": float(np.quantile(self.rows[key], q)) for q in _QUANTILES} for key in _QUANTITIES}
        return {
            "variant": self.policy.variant, "episodes": len(self.rows["success"]), "successful": self.successful,
            "quantile": self.quantile, "margin": self.margin, "proposal": self.proposal(), "quantiles": quantiles,
        }  # fmt: skip

    def text(self) -> str:
        """Markdown: quantiles, and the proposal as options of a command line."""
        quantiles, proposal = self.as_json()["quantiles"], self.proposal()
        lines = [
            [f"{key} [{unit}]", *(f"{value:.3f}" for value in quantiles[key].values())]
            for key, unit in _QUANTITIES.items()
        ]
        warning = (
            ""
            if self.successful
            else "No episode succeeded, so all of them are used; train a policy that solves the task first.\n\n"
        )
        return (
            f"{len(self.rows['success'])} episodes of {self.policy.variant} without limits, {self.successful} of them "
            f"successful\n\n{markdown(['quantile', *(f'{q:g}' for q in _QUANTILES)], lines)}\n\n{warning}"
            f"proposal: --p-max {proposal['p_max']:.3g} --e-max {proposal['e_max']:.3g}"
        )

    def write(self, directory: Path) -> None:
        """Write ``calibration.json`` and ``calibration.png``.

        Args:
            directory: target directory.
        """
        write_text_atomically(directory / "calibration.json", json.dumps(self.as_json(), indent=2) + "\n")
        plot_calibration(self.rows, directory / "calibration.png", **self.proposal())


def calibrate(
    policy: Policy, *, episodes: int, seed: int, num_envs: int = 128, quantile: float = 0.99, margin: float = 1.1
) -> Calibration:
    """Run a policy without the limits of a tank and propose limits.

    Args:
        policy: the policy; a tank in its chain is opened wide.
        episodes: number of fresh episodes.
        seed: seed of the episodes.
        num_envs: number of environments that step together.
        quantile: share of the successful episodes that the limits shall leave untouched [0-1].
        margin: factor on that quantile, for what the episodes did not show [-].

    Returns:
        The calibration.

    Raises:
        ValueError: if a number is out of range.
    """
    require_run_options(episodes=episodes, seed=seed, num_envs=num_envs)
    if not 0.0 < require_number("quantile", quantile, "a share in (0, 1]") <= 1.0:
        raise ValueError(f"quantile is {quantile}; expected a share in (0, 1].")
    if not require_number("margin", margin, "a factor of at least 1") >= 1.0:
        raise ValueError(f"margin is {margin}; expected a factor of at least 1.")
    limits = {"p_max": _NO_LIMIT, "e_max": _NO_LIMIT} if policy.recipe.has_tank else {"p_max": _NO_LIMIT}
    free = policy.with_changes(**limits)
    env = free.make_env(min(num_envs, episodes), seed=seed, audit=True)
    rows = run_episodes(env, policy.actor, episodes, progress=f"{policy.variant} without limits")
    env.close()
    return Calibration(policy, rows, quantile, margin)
