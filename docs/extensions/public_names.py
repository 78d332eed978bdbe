"""Links in docstrings to the entries of the API reference, whatever module an object was defined in.

A docstring names an object where it is defined (``ppt_rl.functional.tank_ahead.rate_tank``); its entry stands where
users import it from (``ppt_rl.functional.rate_tank``). A link to an object without an entry leads to no page, but the
object has to exist; otherwise Sphinx warns, and the build fails.
"""

from __future__ import annotations

import importlib
import pkgutil
import re
from collections.abc import Iterator
from functools import cache
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.ext import autosummary
from sphinx.pycode import ModuleAnalyzer

_ABSENT = object()


@cache
def modules() -> tuple[str, ...]:
    """Names of all modules of the library."""
    package = importlib.import_module("ppt_rl")
    found = [module.name for module in pkgutil.walk_packages(package.__path__, "ppt_rl.")]
    left_out = ("ppt_rl.recipes", "ppt_rl.pretrained", "ppt_rl.__main__")
    return ("ppt_rl", *(name for name in found if not name.startswith(left_out)))


def find(name: str) -> Any:
    """The object of a dotted name.

    Args:
        name: module, then attributes.

    Returns:
        The object, or a mark where there is none.
    """
    parts = name.split(".")
    for cut in range(len(parts), 0, -1):
        module = ".".join(parts[:cut])
        if module not in modules():
            continue
        value: Any = importlib.import_module(module)
        for part in parts[cut:]:
            annotated = part in getattr(value, "__annotations__", {})
            value = getattr(value, part, None if annotated else _ABSENT)
            if value is _ABSENT:
                return _ABSENT
        return value
    return _ABSENT


def _candidates(target: str, node: nodes.Element) -> Iterator[str]:
    """Dotted names that a reference may stand for, the nearest first."""
    module, owner = node.get("py:module"), node.get("py:class")
    yield target
    if module and owner:
        yield f"{module}.{owner}.{target}"
    if module:
        yield f"{module}.{target}"
        definition = getattr(find(f"{module}.{owner}"), "__module__", None) if owner else None
        if definition:
            yield f"{definition}.{target}"
    for name in modules():  # a name that stands in some module, such as one imported for its type only
        if "." not in target and target in getattr(importlib.import_module(name), "__all__", ()):
            yield f"{name}.{target}"


def resolve(app: Sphinx, env: BuildEnvironment, node: nodes.Element, content: nodes.Element) -> nodes.Node | None:
    """Link a reference that Sphinx did not find to the entry of the same object.

    Args:
        app: Sphinx.
        env: its environment.
        node: the reference.
        content: what the reader sees.

    Returns:
        A link; the content alone where the object exists without an entry; None where it does not exist.
    """
    if node.get("refdomain") != "py":
        return None
    entries = env.domains["py"].objects  # type: ignore[attr-defined]
    for name in _candidates(node["reftarget"], node):
        value = find(name)
        if value is _ABSENT:
            continue
        same = [entry for entry in _aliases(name) if entry in entries]
        if not same:
            return content
        entry = entries[same[0]]
        uri = app.builder.get_relative_uri(node["refdoc"], entry.docname)
        return nodes.reference("", "", content, internal=True, refuri=f"{uri}#{entry.node_id}", reftitle=same[0])
    return None


def _aliases(name: str) -> list[str]:
    """The same object under the names of the packages above it, the shortest first."""
    value, parts, found = find(name), name.split("."), []
    for cut in range(1, len(parts)):
        for kept in (1, 2):  # the name alone, or a member with its class
            alias = ".".join([*parts[:cut], *parts[max(cut, len(parts) - kept) :]])
            if alias not in found and find(alias) is value:
                found.append(alias)
    return found


def summary(lines: list[str], document: nodes.document) -> str:
    """First sentence of a docstring, for tables; a full stop within a formula does not end it.

    Args:
        lines: the docstring.
        document: the page.

    Returns:
        The sentence.
    """
    paragraph = []
    for line in (line for line in lines if line.strip() != ".."):
        if paragraph and not line.strip():
            break
        paragraph += [line.strip()] if line.strip() else []
    pieces = re.split(r"(``.*?``|`.*?`)", " ".join(paragraph))
    text = ""
    for i, piece in enumerate(pieces):
        sentence, stop, _ = piece.partition(". ") if i % 2 == 0 else (piece, "", "")
        text += sentence
        if stop:
            return text + "."
    return text


def plain_property(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Keep napoleon from reading what stands before a colon in a property's docstring as a type.

    Args:
        app: Sphinx.
        what: kind of the object.
        name: its dotted name.
        obj: the object.
        options: options of autodoc.
        lines: its docstring, changed in place.
    """
    if what in ("attribute", "data", "property"):
        lines[:0] = ["..", ""]  # an empty comment, whose line is taken for the type


def comments(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Give a constant the comment that stands above it where it is defined, and leave out repeated ones.

    Args:
        app: Sphinx.
        what: kind of the object.
        name: its dotted name.
        obj: the object.
        options: options of autodoc.
        lines: its docstring, changed in place.
    """
    if what not in ("data", "class", "property") or (what == "class" and getattr(obj, "__module__", None) != "typing"):
        return
    last = name.rsplit(".", 1)[-1]
    for module in modules():
        if module.startswith(name.split(".")[0]) and getattr(importlib.import_module(module), last, _ABSENT) is obj:
            found = ModuleAnalyzer.for_module(module).find_attr_docs().get(("", last))
            if found:
                lines[:] = found
                return


def skip(app: Sphinx, what: str, name: str, obj: Any, skipped: bool, options: Any) -> bool | None:
    """Leave out the fields of named tuples: their class documents them.

    Args:
        app: Sphinx.
        what: kind of the owner.
        name: name of the member.
        obj: the member.
        skipped: whether autodoc leaves it out.
        options: options of autodoc.

    Returns:
        True to leave it out, None to leave it to autodoc.
    """
    return True if str(getattr(obj, "__doc__", "")).startswith("Alias for field number") else None


def source_of(app: Sphinx, module: str, name: str) -> str | None:
    """Leave constants where they are listed: no module of the library defines the type of a number or a tuple.

    Args:
        app: Sphinx.
        module: module that an entry names.
        name: name of the object in it.

    Returns:
        The module for a constant; None leaves the question to viewcode.
    """
    defined = getattr(find(f"{module}.{name}"), "__module__", None)
    return None if isinstance(defined, str) and defined.startswith("ppt_rl") else module


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect.

    Args:
        app: Sphinx.

    Returns:
        What Sphinx asks of an extension.
    """
    app.connect("viewcode-follow-imported", source_of)
    app.connect("missing-reference", resolve)
    autosummary.extract_summary = summary
    app.connect("autodoc-process-docstring", comments, priority=300)
    app.connect("autodoc-process-docstring", plain_property, priority=400)  # before napoleon
    app.connect("autodoc-skip-member", skip)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
