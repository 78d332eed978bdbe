"""The subcommand ``collide`` of ``ppt-rl``: its options, and what it does. Heavy imports wait until it is run."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from ppt_rl.commands import _check, _load, _Settings

if TYPE_CHECKING:
    from ppt_rl.evaluation import Policy

__all__ = ["Collide"]


@dataclass(frozen=True)
class Collide:
    """Measure how hard policies strike and press when something goes wrong: the collision benchmark.

    Attributes:
        policies: published policies, checkpoints or runs, all of one task that has collision scenarios.
        scenario: names of the scenarios; by default all of the task.
        settings: options of the recipes to change, as NAME=VALUE.
        episodes: number of episodes of a policy in a scenario.
        seed: seed of the episodes, which are the same for every policy.
        num_envs: number of environments that step together.
        num_threads: physics threads; 0 takes one per CPU.
        json: end with one line of JSON: for one policy in one scenario its figures, of several by their names.
        report: write tables, every episode and a figure into this directory.
    """

    policies: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="POLICY")]
    scenario: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...")] = ()
    settings: _Settings = ()
    episodes: int = 256
    seed: int = 40_000
    num_envs: int = 128
    num_threads: int = 0
    json: bool = False
    report: Path | None = None

    def load(self) -> dict[str, Policy]:
        """Load the policies with their changed options, by variant; by what was given where variants are the same."""
        if not self.policies:
            raise ValueError("no policy is given; expected at least one.")
        twice = sorted({name for name in self.policies if self.policies.count(name) > 1})
        if twice:
            raise ValueError(f"policies {twice} are given more than once; expected different ones.")
        settings = (*self.settings, f"num_threads={self.num_threads}")
        loaded = {name: _load(name, None, settings) for name in self.policies}
        variants = [policy.variant for policy in loaded.values()]
        return {
            policy.variant if variants.count(policy.variant) == 1 else name: policy for name, policy in loaded.items()
        }

    def run(self) -> None:
        """Collide and report."""
        from ppt_rl.evaluation import collide

        _check(episodes=self.episodes, seed=self.seed, num_envs=self.num_envs, report=self.report)
        result = collide(
            self.load(), scenarios=self.scenario, episodes=self.episodes, seed=self.seed, num_envs=self.num_envs
        )
        print(f"{self.episodes} episodes a row, seed {self.seed}\n\n{result.tables()}")
        if self.report is not None:
            result.write(self.report)
            print(f"report in {self.report}")
        if self.json:
            print(json.dumps(result.as_json()))
