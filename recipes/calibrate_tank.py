"""Find the limits of an energy tank: run a policy without any and look at the power and the work it takes.

``python recipes/calibrate_tank.py CHECKPOINT --report OUT``
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
import tyro
from registry import load_policy

from ppt_rl.evaluation import run_episodes
from ppt_rl.evaluation.figures import plot_calibration
from ppt_rl.training import run_cli
from ppt_rl.training.logs import write_text_atomically

#: Limits that no robot reaches: a tank that never closes.
_NO_LIMIT = 1e6
_QUANTILES = (0.5, 0.75, 0.9, 0.95, 0.99, 1.0)


@dataclass(frozen=True)
class Config:
    """Run a policy without limits, report its power and work, and propose p_max and e_max.

    Attributes:
        checkpoint: a checkpoint, the directory of a run for its newest one, or a published policy.
        episodes: fresh episodes to run.
        seed: of the episodes.
        num_envs: environments that step together.
        num_threads: physics threads; 0 takes one per CPU.
        quantile: share of the successful episodes that the proposed limits would leave untouched [0-1].
        margin: factor on that quantile, for what the episodes did not show [-].
        json: end with one line of JSON.
        report: write calibration.json and calibration.png into this directory.
    """

    checkpoint: Annotated[Path, tyro.conf.Positional]
    episodes: int = 512
    seed: int = 20_000
    num_envs: int = 128
    num_threads: int = 0
    quantile: float = 0.99
    margin: float = 1.1
    json: bool = False
    report: Path | None = None

    def __post_init__(self) -> None:
        """Refuse impossible settings."""
        if not 0.0 < self.quantile <= 1.0:
            raise ValueError(f"quantile is {self.quantile}; expected a share in (0, 1].")
        if not self.margin >= 1.0:
            raise ValueError(f"margin is {self.margin}; expected a factor of at least 1.")


def calibrate(run: Config) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Quantiles of power and work without limits, the proposal, and the rows they come from."""
    policy = load_policy(run.checkpoint)
    limits: dict[str, Any] = (
        {"p_max": _NO_LIMIT, "e_max": _NO_LIMIT} if hasattr(policy.config, "e_max") else {"p_max": _NO_LIMIT}
    )
    env = policy.make_env(
        num_envs=min(run.num_envs, run.episodes), seed=run.seed, audit=True, num_threads=run.num_threads, **limits
    )
    rows = run_episodes(env, policy.actor, run.episodes)
    env.close()
    successful = rows["success"] > 0.5
    chosen = successful if successful.any() else np.ones_like(successful)
    proposal = {
        name: run.margin * float(np.quantile(rows[key][chosen], run.quantile))
        for name, key in (("p_max", "max_power"), ("e_max", "work"))
    }
    quantiles = {
        key: {f"{q:g}": float(np.quantile(rows[key], q)) for q in _QUANTILES}
        for key in ("max_power", "work", "audit_commanded_power", "audit_commanded_work")
    }
    result = {
        "variant": policy.variant, "episodes": run.episodes, "successful": int(successful.sum()),
        "quantile": run.quantile, "margin": run.margin, "proposal": proposal, "quantiles": quantiles,
    }  # fmt: skip
    return result, rows


def main(run: Config) -> None:
    """Calibrate and report."""
    result, rows = calibrate(run)
    proposal = result["proposal"]
    print(f"{run.checkpoint}, {run.episodes} episodes without limits, {result['successful']} of them successful\n")
    print("| quantile | " + " | ".join(f"{q:g}" for q in _QUANTILES) + " |")
    print("|---" * (len(_QUANTILES) + 1) + "|")
    for key, values in result["quantiles"].items():
        unit = "J" if key.endswith("work") else "W"
        print(f"| {key} [{unit}] | " + " | ".join(f"{value:.3f}" for value in values.values()) + " |")
    if not result["successful"]:
        print("\nNo episode succeeded, so the proposal is from all of them: train a policy that solves the task first.")
    print(f"\nproposal: --p-max {proposal['p_max']:.3g} --e-max {proposal['e_max']:.3g}")
    if run.report is not None:
        write_text_atomically(run.report / "calibration.json", json.dumps(result, indent=2) + "\n")
        plot_calibration(rows, run.report / "calibration.png", **proposal)
        print(f"report in {run.report}")
    if run.json:
        print(json.dumps(result))


if __name__ == "__main__":
    torch.set_num_threads(1)
    torch.manual_seed(0)
    run_cli(main, Config)
