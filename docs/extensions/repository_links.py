"""Links of the Markdown files as they work in the repository, turned into links of the site.

A link to a page of the site leads there, one to a file of the repository offers it for download, and a picture is
copied. A link that leads nowhere is a warning, which fails the build.
"""

from __future__ import annotations

import re
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.util import logging

LOGGER = logging.getLogger(__name__)
DOCS = Path(__file__).resolve().parents[1]
ROOT = DOCS.parent
#: Folders and files of the repository that have a page.
PAGES = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "docs": "index.md",
    "examples": "examples.md",
    "examples/reach": "examples.md#reach",
    "examples/reacher.py": "examples.md#reacher",
    "examples/wipe": "examples.md#wipe",
    "pretrained": "results/policies.md",
    "pretrained/README.md": "results/policies.md",
    "recipes": "recipes.md",
    "results": "results/index.md",
}
_LINK = re.compile(r"(!?\[(?:[^\[\]]|\[[^\]]*\])*\]\()([^)\s]+)(\))")
_FENCE = re.compile(r"^(`{3,}|~{3,})")


def page_of(path: Path) -> str | None:
    """Page of the site that shows a file or folder of the repository.

    Args:
        path: the file or folder.

    Returns:
        Path of the page within ``docs``, or None.
    """
    if path.is_relative_to(DOCS) and path.suffix == ".md":
        return str(path.relative_to(DOCS))
    name = str(path.relative_to(ROOT))
    if name in PAGES:
        return PAGES[name]
    recipe = re.fullmatch(r"recipes/(\w+)\.py", name)
    if recipe:
        return f"recipes.md#{recipe[1]}"
    table = re.fullmatch(r"results/(\w+)/(tables|collisions)\.md", name)
    if table:
        return f"results/tables/{table[1]}.md"
    result = re.fullmatch(r"results/(\w+)(/README\.md)?", name)
    if result and (DOCS / "results" / f"{result[1]}.md").is_file():
        return f"results/{result[1]}.md"
    return None


def rewritten(text: str, folder: Path, where: str) -> str:
    """Markdown whose links to the repository are links of the site.

    Args:
        text: Markdown.
        folder: folder that its links are relative to.
        where: name of the file, for messages.

    Returns:
        The Markdown.
    """

    def link(match: re.Match[str]) -> str:
        before, target, after = match.groups()
        path, _, anchor = target.partition("#")
        if not path or path.startswith("/") or re.match(r"[a-z]+:", path):
            return match[0]
        found = (folder / path).resolve()
        if not found.exists() and not found.with_suffix(".rst").exists():
            LOGGER.warning("%s: link to %s, which does not exist", where, target, type="repository_links")
            return match[0]
        if not found.is_relative_to(ROOT):
            LOGGER.warning("%s: link to %s, outside of the repository", where, target, type="repository_links")
            return match[0]
        page = page_of(found)
        if page is None and found.is_dir():
            LOGGER.warning("%s: link to the folder %s, which has no page", where, target, type="repository_links")
            return match[0]
        if page is None:
            page = "../" + str(found.relative_to(ROOT))
        page = page if not anchor else f"{page.partition('#')[0]}#{anchor}"
        return f"{before}/{page}{after}"

    lines, fence = [], ""
    for line in text.split("\n"):
        mark = _FENCE.match(line)
        if mark and not fence:
            fence = mark[1]
        elif fence and line.startswith(fence):
            fence = ""
        lines.append(line if fence else _LINK.sub(link, line))
    return "\n".join(lines)


def read_source(app: Sphinx, docname: str, content: list[str]) -> None:
    """Rewrite the links of a page.

    Args:
        app: Sphinx.
        docname: the page.
        content: its text, changed in place.
    """
    path = Path(app.env.doc2path(docname))
    if path.suffix == ".md":
        content[0] = rewritten(content[0], path.parent, docname)


def read_included(app: Sphinx, path: Path, docname: str, content: list[str]) -> None:
    """Rewrite the links of a file that a page includes.

    Args:
        app: Sphinx.
        path: the file, relative to the pages.
        docname: the page.
        content: its text, changed in place.
    """
    file = (Path(app.srcdir) / path).resolve()
    if file.suffix == ".md":
        content[0] = rewritten(content[0], file.parent, str(path))


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect.

    Args:
        app: Sphinx.

    Returns:
        What Sphinx asks of an extension.
    """
    app.connect("source-read", read_source)
    app.connect("include-read", read_included)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
