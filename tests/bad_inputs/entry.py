"""One entry of a table of bad inputs, and short ways to write many of them."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import torch

__all__ = ["BadCommand", "BadInput", "bad", "each"]


@dataclass(frozen=True)
class BadInput:
    """An input that must be refused with one clear message.

    Attributes:
        name: what is wrong, unique in all tables.
        make: gives the input to the public interface.
        match: regular expression that the message must satisfy: the option or field and what came.
        pending: whether it is not refused well yet; then the test expects it to fail, and fails once it passes.
    """

    name: str
    make: Callable[[], object]
    match: str
    pending: bool = False


@dataclass(frozen=True)
class BadCommand:
    """A command line that must be refused with status 2 and one line on standard error.

    Attributes:
        args: arguments of ``ppt-rl``; ``{tmp}`` stands for a folder of broken files.
        match: as for :class:`BadInput`.
        pending: likewise.
    """

    args: tuple[str, ...]
    match: str
    pending: bool = False

    @property
    def name(self) -> str:
        """The command line."""
        return " ".join(("ppt-rl", *(arg or "''" for arg in self.args)))


def bad(call: Callable[..., object], match: str, *args: Any, pending: bool = False, **kwargs: Any) -> BadInput:
    """An entry that is one call.

    Args:
        call: what is called.
        match: as for :class:`BadInput`.
        *args: arguments of the call.
        pending: as for :class:`BadInput`.
        **kwargs: further arguments of the call.
    """
    shown = [_short(value) for value in args] + [f"{name}={_short(value)}" for name, value in kwargs.items()]
    name = getattr(call, "__qualname__", type(call).__name__)
    return BadInput(f"{name}({', '.join(shown)})", partial(call, *args, **kwargs), match, pending)


def each(
    call: Callable[..., object],
    name: str,
    values: Sequence[Any],
    match: str,
    *args: Any,
    pending: bool = False,
    **kwargs: Any,
) -> list[BadInput]:
    """An entry for each bad value of one argument.

    Args:
        call: what is called.
        name: of the argument.
        values: the bad values.
        match: as for :class:`BadInput`; ``{name}`` and ``{value}`` stand for name and value as a message shows them.
        *args: other arguments of the call.
        pending: as for :class:`BadInput`.
        **kwargs: likewise.
    """
    return [
        bad(
            call,
            match.replace("{name}", name).replace("{value}", re.escape(shown_value(value))),
            *args,
            pending=pending,
            **{name: value},
            **kwargs,
        )
        for value in values
    ]


def shown_value(value: object) -> str:
    """A value as messages show it: text in quotes."""
    return repr(value) if isinstance(value, str) else str(value)


def _short(value: object) -> str:
    if isinstance(value, torch.Tensor):
        same = value.unique() if value.numel() else value  # NaN is not the same as itself
        content = f" of {same.item():g}" if same.numel() == 1 else " with NaN" if bool(value.isnan().any()) else ""
        kind = "" if value.dtype is torch.float32 else f" of {value.dtype}"
        return f"tensor{tuple(value.shape)}{content}{kind}"
    text = " ".join(repr(value).split())
    return re.sub(r" at 0x[0-9a-fA-F]+", "", text if len(text) <= 60 else f"{text[:57]}...")
