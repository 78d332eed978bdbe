"""Formulas as MathML, which browsers draw by themselves: no network, script or font is needed to read the site."""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from docutils.utils.math import MathError, latex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging

LOGGER = logging.getLogger(__name__)
#: Commands that docutils does not know, and what draws the same.
_INSTEAD = {
    r"\textstyle": "",
    r"\tfrac": r"\frac",
    r"\dfrac": r"\frac",
    r"\lVert": r"\|",
    r"\rVert": r"\|",
    r"\lvert": "|",
    r"\rvert": "|",
    r"\coloneqq": ":=",
    r"\dots": r"\ldots",
}
#: Sizes that say neither left nor right.
_SIZE = re.compile(r"\\(big|Big|bigg|Bigg)(?=([(\[|)\]]))")

#: Arguments without braces, of which docutils takes more than TeX does.
_BRACES = [
    (re.compile(r"\\frac\s*(\w)\s*(\w)"), r"\\frac{\1}{\2}"),
    (re.compile(r"\\frac\s*(\w)\s*(?=\{)"), r"\\frac{\1}"),
    (re.compile(r"\\(dot|ddot|hat|bar|tilde)\s*\{?(\w)\}?_(\w|\{[^{}]*\})"), r"\\\1{\2_\3}"),
    (re.compile(r"\\(dot|ddot|hat|bar|tilde)\s+(\w)"), r"\\\1{\2}"),
]


def _mathml(node: nodes.Element, *, block: bool) -> str:
    """MathML of a formula; one that cannot be drawn is a warning, which fails the build."""
    text = node.astext()
    for command, other in _INSTEAD.items():
        text = re.sub(re.escape(command) + r"(?![A-Za-z])", lambda _, other=other: other, text)
    for pattern, other in _BRACES:
        text = pattern.sub(other, text)
    text = _SIZE.sub(lambda size: "\\" + size[1] + ("r" if size[2] in ")]" else "l"), text)
    if block and (r"\\" in text or "&" in text) and r"\begin{" not in text.lstrip()[:7]:
        text = rf"\begin{{aligned}}{text}\end{{aligned}}"
    text = re.sub(r"\\(begin|end)\{(align|gather|equation)\*?\}", r"\\\1{aligned}", text)
    try:
        return latex2mathml.tex2mathml(text, as_block=block)
    except MathError as error:
        LOGGER.warning("a formula cannot be drawn, %s: %s", error, text, location=node, type="math")
        return f"<code>{text}</code>"


def inline(translator: Any, node: nodes.Element) -> None:
    """A formula within a line.

    Args:
        translator: what writes the page.
        node: the formula.

    Raises:
        nodes.SkipNode: always; the node is written.
    """
    translator.body.append(_mathml(node, block=False))
    raise nodes.SkipNode


def display(translator: Any, node: nodes.Element) -> None:
    """A formula on lines of its own.

    Args:
        translator: what writes the page.
        node: the formula.

    Raises:
        nodes.SkipNode: always; the node is written.
    """
    translator.body.append(f'<div class="math">{_mathml(node, block=True)}</div>')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the renderer.

    Args:
        app: Sphinx.

    Returns:
        What Sphinx asks of an extension.
    """
    app.add_html_math_renderer("mathml", (inline, None), (display, None))
    app.config.html_math_renderer = "mathml"  # type: ignore[attr-defined]
    return {"parallel_read_safe": True, "parallel_write_safe": True}
