"""The command ``ppt-rl``: train, judge, film, view, collide, compare and calibrate, for every task."""

from __future__ import annotations

import sys
from typing import Annotated, Any

import tyro

from ppt_rl.collide_command import Collide
from ppt_rl.commands import CalibrateTank, Evaluate, Film, Policies, Study, Sweep, Train
from ppt_rl.view_command import View

__all__ = ["main"]


def _command(options: type, name: str) -> Any:
    return Annotated[options, tyro.conf.subcommand(name, prefix_name=False)]


_Command = (
    _command(Train, "train")
    | _command(Evaluate, "evaluate")
    | _command(Film, "film")
    | _command(View, "view")
    | _command(Collide, "collide")
    | _command(Study, "study")
    | _command(CalibrateTank, "calibrate-tank")
    | _command(Sweep, "sweep")
    | _command(Policies, "policies")
)


def main() -> None:
    """Run the command line of the process."""
    args = sys.argv[1:]
    if len(args) > 1 and args[0] == "train" and not args[1].startswith("-"):
        _train(args[1], args[2:])
        return
    command = tyro.cli(_Command, args=args, prog="ppt-rl")  # before torch is imported, so that help is quick
    import torch

    from ppt_rl.training.script import advice_instead_of_traceback

    torch.set_num_threads(1)
    torch.manual_seed(0)
    with advice_instead_of_traceback("ppt-rl"):
        command.run()


def _train(variant: str, args: list[str]) -> None:
    """Train with the options of the variant's recipe."""
    from ppt_rl.evaluation import find_recipe
    from ppt_rl.training.script import advice_instead_of_traceback

    with advice_instead_of_traceback("ppt-rl"):
        recipe = find_recipe(variant)
    recipe.main(args, prog=f"ppt-rl train {variant}")
