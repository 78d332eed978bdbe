"""The role ``{impl}``: an object of the library with the file and the line at which it stands now."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from docutils import nodes
from public_names import _ABSENT, find
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxRole

ROOT = Path(__file__).resolve().parents[2]


def place_of(value: Any) -> tuple[str, int]:
    """File and line of a class, a function or a method.

    Args:
        value: the object.

    Returns:
        The file, relative to the repository, and the line of its ``def`` or ``class``.

    Raises:
        TypeError: if the object is none of these.
    """
    value = value.fget if isinstance(value, property) else inspect.unwrap(value)
    source, first = inspect.getsourcelines(value)
    decorated = next(i for i, line in enumerate(source) if line.lstrip().startswith(("def ", "class ")))
    return str(Path(inspect.getsourcefile(value) or "").resolve().relative_to(ROOT)), first + decorated


class Implementation(SphinxRole):
    """``{impl}`` with the dotted name of an object links to its entry and says where it is implemented."""

    def run(self) -> tuple[Sequence[nodes.Node], list[nodes.system_message]]:
        """Make the nodes."""
        value = find(self.text)
        try:
            file, line = place_of(None if value is _ABSENT else value)
        except (TypeError, OSError):
            message = self.inliner.reporter.warning(
                f"{self.text!r} is no class, function or method of the library; expected a dotted name of one.",
                line=self.lineno,
            )
            return [nodes.literal(text=self.text)], [message]
        shown = ".".join(self.text.split(".")[-2:]) if inspect.isfunction(value) and "." in value.__qualname__ else None
        literal = nodes.literal(text=shown or self.text.rsplit(".", 1)[-1])
        link = addnodes.pending_xref(
            "", literal, refdomain="py", reftype="obj", reftarget=self.text, refdoc=self.env.docname, refexplicit=True
        )
        return [link, nodes.Text(" ("), nodes.emphasis(text=f"{file}, line {line}"), nodes.Text(")")], []


def one_thread(gallery_conf: dict[str, Any], fname: str) -> None:
    """Let torch use one thread in a tutorial: the physics has threads of its own.

    Args:
        gallery_conf: options of the gallery.
        fname: the tutorial.
    """
    torch.set_num_threads(1)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the role.

    Args:
        app: Sphinx.

    Returns:
        What Sphinx asks of an extension.
    """
    app.add_role("impl", Implementation())
    return {"parallel_read_safe": True, "parallel_write_safe": True}
