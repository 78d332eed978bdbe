"""Command lines: typed options, and errors that read like advice instead of a traceback."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from typing import Any, TypeVar

import tyro

from ppt_rl.training.checkpoint import CheckpointMismatch

__all__ = ["run_cli"]

_Config = TypeVar("_Config")


def run_cli(main: Callable[[_Config], Any], config_class: type[_Config]) -> None:
    """Parse the options of a dataclass and run.

    A wrong value or an unfit checkpoint ends the program with its message and status 2, Ctrl-C with
    130.

    Args:
        main: called with the parsed configuration.
        config_class: dataclass with documented fields.
    """
    warnings.filterwarnings("ignore", category=FutureWarning, module="torchrl")
    try:
        main(tyro.cli(config_class))
    except KeyboardInterrupt:
        raise SystemExit(130) from None
    except (CheckpointMismatch, ValueError, KeyError) as error:
        message = error.args[0] if error.args else error
        print(f"{sys.argv[0]}: error: {message}", file=sys.stderr)
        raise SystemExit(2) from error
