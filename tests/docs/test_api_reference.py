from __future__ import annotations

import importlib
import inspect
import pkgutil
import re

import pytest

import ppt_rl

PACKAGES = ["ppt_rl", *(m.name for m in pkgutil.walk_packages(ppt_rl.__path__, "ppt_rl.") if m.ispkg)]
PACKAGES = [name for name in PACKAGES if name.split(".")[1:2] not in (["recipes"], ["pretrained"])]
NO_ENTRY = {"ppt_rl.__version__"}  # a string, which the page of ppt_rl explains in a sentence


def listed(root):
    """Dotted names that the pages of the API reference list, each under the module that stands above it."""
    names = []
    for page in sorted((root / "docs" / "api").glob("*.rst")):
        module, in_table = "", False
        for line in page.read_text(encoding="utf-8").splitlines():
            if line.startswith(".. currentmodule::"):
                module = line.split("::")[1].strip()
            in_table = line.startswith(".. autosummary::") or (in_table and (not line or line.startswith("   ")))
            if in_table and re.fullmatch(r"   \w+", line):
                names.append(f"{module}.{line.strip()}")
    return names


def value_of(name):
    module, _, attribute = name.rpartition(".")
    return getattr(importlib.import_module(module), attribute)


def public_names():
    for package in PACKAGES:
        yield from (f"{package}.{name}" for name in getattr(importlib.import_module(package), "__all__", ()))


def test_every_public_name_has_an_entry_in_the_reference(root):
    entries = [(name.rpartition(".")[2], value_of(name)) for name in listed(root)]
    assert len(entries) > 150
    missing = [
        name
        for name in public_names()
        if name not in NO_ENTRY
        and not any(last == name.rpartition(".")[2] and value is value_of(name) for last, value in entries)
    ]
    assert not missing, (
        f"{missing} are public, but no page in docs/api lists them; add them to the page of their package."
    )


def test_every_entry_exists_once(root):
    names = listed(root)
    assert all(value_of(name) is not None for name in names)
    assert len(names) == len(set(names))


def functions():
    """Public functions and the public methods of public classes, by dotted name, each where it is defined."""
    found = {}
    for name in public_names():
        value = value_of(name)
        if inspect.isfunction(value):
            found[f"{value.__module__}.{value.__qualname__}"] = value
        if inspect.isclass(value) and value.__module__.startswith("ppt_rl"):
            for attribute, member in vars(value).items():
                member = member.__func__ if isinstance(member, (classmethod, staticmethod)) else member
                if not attribute.startswith("_") and inspect.isfunction(member) and member.__doc__:
                    found[f"{value.__module__}.{member.__qualname__}"] = member
    return sorted(found.items())


def section(doc, title):
    """Text of a section of a Google-style docstring, or None."""
    found = re.search(rf"^{title}:\n((?:[ \t]+.*\n?|\n)*)", doc, re.MULTILINE)
    return None if found is None else found[1]


#: Overrides of torchrl's methods: their arguments are those of the base class.
OVERRIDES = re.compile(r"\.(transform_\w+|forward|set_\w+|__call__|to)$")


@pytest.mark.parametrize(("name", "value"), functions(), ids=lambda value: value if isinstance(value, str) else "")
def test_a_docstring_has_a_section_for_arguments_and_one_for_what_is_returned(name, value):
    if OVERRIDES.search(name):
        return
    doc = inspect.getdoc(value)
    assert doc, f"{name} has no docstring"
    if re.match(r"(See|As) :meth:`", doc):  # the interface that it implements has a docstring of its own
        return
    parameters = [p for p in inspect.signature(value).parameters if p not in ("self", "cls")]
    if not parameters:
        return
    prose = len(doc.splitlines()) == 1 or section(doc, "Args") is None
    text = doc if prose else section(doc, "Args")
    entry = r"\b{}\b" if prose else r"^ *(?:[*\w]+, )*\*{{0,2}}{}(?:, [*\w]+)*:"
    missing = [p for p in parameters if not re.search(entry.format(p), text, re.MULTILINE)]
    assert not missing, f"{name} does not document {missing} under Args"
    returns = inspect.signature(value).return_annotation
    if not prose and returns not in (None, "None", inspect.Signature.empty, "NoReturn") and "contextmanager" not in doc:
        assert section(doc, "Returns") or section(doc, "Yields"), (
            f"{name} returns {returns}, but has no section Returns"
        )
