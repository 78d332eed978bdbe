"""The subcommand ``view`` of ``ppt-rl``: its options, and what it does. Heavy imports wait until it is run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import tyro

from ppt_rl.commands import _check, _load, _Settings

if TYPE_CHECKING:
    from ppt_rl.evaluation import Policy

__all__ = ["View"]


@dataclass(frozen=True)
class View:
    """Watch a policy in the browser, in real time, and change its limits: needs ppt_rl[view].

    Attributes:
        policy: name of a published policy, or path of a checkpoint, a run or a directory with a card.
        recipe: variant or file of the recipe; by default the one that trained the policy.
        settings: options of the recipe to change, as NAME=VALUE.
        seed: seed of the episodes.
        host: address to listen at; 0.0.0.0 lets other machines look too.
        port: port to listen at; where it is taken, the next free one.
    """

    policy: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="POLICY")]
    recipe: str | None = None
    settings: _Settings = ()
    seed: int = 10_000
    host: str = "127.0.0.1"
    port: int = 8080

    def load(self) -> Policy:
        """Load the policy with its changed options; one world is simulated on the CPU, whatever trained the policy."""
        return _load(self.policy, self.recipe, (*self.settings, "num_threads=1", "device=cpu", "engine=threads"))

    def run(self) -> None:
        """Serve the view until Ctrl-C."""
        from ppt_rl.training.extras import require_package

        require_package("viser", "view", "the live view")
        _check(episodes=1, seed=self.seed)
        from ppt_rl.view import LiveView

        view = LiveView(self.load(), host=self.host, port=self.port, seed=self.seed)
        print(f"{self.policy} is at {view.url}; Ctrl-C ends it", flush=True)
        try:
            view.run()
        finally:
            view.close()
            print(f"{view.rate:.0f} pictures a second were sent")
