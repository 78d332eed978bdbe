from __future__ import annotations

import dataclasses
import importlib
import inspect
import pkgutil
import re
import subprocess
import sys

import pytest

import ppt_rl

MODULES = sorted(
    info.name for info in pkgutil.walk_packages(ppt_rl.__path__, "ppt_rl.") if not info.name.endswith("__main__")
)


def public_objects():
    for name in MODULES:
        module = importlib.import_module(name)
        for attribute in getattr(module, "__all__", []):
            value = getattr(module, attribute)
            if getattr(value, "__module__", name) == name and (inspect.isclass(value) or inspect.isfunction(value)):
                yield f"{name}.{attribute}", value


@pytest.mark.parametrize("name", MODULES)
def test_every_name_in_all_exists(name):
    module = importlib.import_module(name)
    assert module.__doc__
    assert all(hasattr(module, attribute) for attribute in getattr(module, "__all__", []))


@pytest.mark.parametrize(("name", "value"), list(public_objects()))
def test_every_public_object_documents_every_argument(name, value):
    doc = inspect.getdoc(value)
    assert doc, f"{name} has no docstring"
    try:
        parameters = inspect.signature(value).parameters
    except ValueError:
        return
    if dataclasses.is_dataclass(value):  # a field is documented where it is declared
        doc = "\n".join(inspect.getdoc(base) or "" for base in value.__mro__ if dataclasses.is_dataclass(base))
    missing = [p for p in parameters if p not in ("args", "kwargs", "self") and not re.search(rf"\b{p}\b", doc)]
    assert not missing, f"{name} does not document {missing}"


def test_the_snippets_of_the_readme_run(root, tmp_path):
    snippets = re.findall(r"```python\n(.*?)```", (root / "README.md").read_text(), re.DOTALL)
    assert len(snippets) >= 2
    script = tmp_path / "snippets.py"
    script.write_text("\n".join(snippets))
    run = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, cwd=tmp_path)
    assert run.returncode == 0, run.stderr
    assert "display" not in run.stderr.lower()
