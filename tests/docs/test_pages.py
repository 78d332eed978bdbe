from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest
import torch

from ppt_rl.functional import TANK_LAWS
from tests.docs.test_api_reference import PACKAGES, listed, public_names

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted(
    path
    for pattern in ("*.md", "docs/**/*.md", "results/**/*.md", "pretrained/*.md", ".github/**/*.md")
    for path in ROOT.glob(pattern)
    if not {"_build", "generated", "tutorials"} & set(path.parts)
)
TUTORIALS = sorted((ROOT / "examples" / "tutorials").glob("[0-9]*.py"))
FENCE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
GUIDES = [  # a page that serves the live view waits for a browser; tests of its own drive it
    p
    for p in PAGES
    if p.is_relative_to(ROOT / "docs") and "```python" in p.read_text() and "LiveView" not in p.read_text()
]


def name(path):
    return str(path.relative_to(ROOT))


def anchors(page):
    """Anchors of the headings of a page, as they are made of their text."""
    heads = re.findall(r"^#+ (.*)$", FENCE.sub("", page.read_text(encoding="utf-8")), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).strip().replace(" ", "-") for head in heads}


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_every_link_of_a_page_leads_to_a_file_and_to_a_heading_in_it(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", FENCE.sub("", page.read_text(encoding="utf-8"))):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = target.partition("#")
        found = (page.parent / path).resolve() if path else page
        if found.suffix == ".rst" and "tutorials" in found.parts:
            continue  # made by the build, which checks it
        assert found.exists(), f"{name(page)} links to {target}, which does not exist"
        if anchor and found.suffix == ".md":
            assert anchor in anchors(found), f"{name(page)} links to {target}, a heading that does not exist"


@pytest.mark.parametrize("page", GUIDES, ids=name)
def test_the_python_on_a_page_runs(page, tmp_path, monkeypatch):
    if 'device="cuda"' in page.read_text() and not torch.cuda.is_available():
        pytest.skip("needs a CUDA device")
    monkeypatch.chdir(tmp_path)
    laws = dict(TANK_LAWS)
    blocks = re.findall(r"^( *)```python\n(.*?)^ *```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    code = "\n".join(re.sub(rf"^{indent}", "", text, flags=re.MULTILINE) for indent, text in blocks)
    try:
        exec(compile(code, name(page), "exec", dont_inherit=True), {"__name__": "page"})
    finally:
        TANK_LAWS.clear()
        TANK_LAWS.update(laws)


def test_the_guides_are_among_the_pages_that_run():
    assert len(GUIDES) >= 8


@pytest.mark.parametrize("tutorial", TUTORIALS, ids=name)
def test_a_tutorial_uses_names_of_the_reference_only(tutorial):
    public = {*public_names(), *listed(ROOT), *PACKAGES}
    for node in ast.walk(ast.parse(tutorial.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module.split(".")[0] == "ppt_rl":
            used = {f"{node.module}.{alias.name}" for alias in node.names}
            assert used <= public, f"{tutorial.name} uses {used - public}, which the API reference does not have"


def test_no_page_names_a_path_of_one_machine():
    for path in [*PAGES, *TUTORIALS]:
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"(?<![\w.])/(tmp|work|home|root)/", text), path
