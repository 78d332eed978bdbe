import ast
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
#: Packages of the library, each with those that it may import.
ALLOWED = {
    "arms": set(),
    "functional": set(),
    "modules": {"functional", "arms"},
    "transforms": {"functional", "modules", "arms"},
    "envs": {"functional", "modules", "arms"},
    "training": {"functional", "modules"},
    "evaluation": {"functional", "modules", "transforms", "envs", "training"},
    "view": {"functional", "envs", "training", "evaluation"},
    "tasks": {"arms", "functional", "modules", "transforms", "envs", "training", "evaluation"},
}
FILES = sorted((ROOT / "ppt_rl").rglob("*.py"))


def package(path):
    """Package of the library that a file belongs to; the empty name for the library's own ``__init__``."""
    parts = path.relative_to(ROOT / "ppt_rl").parts
    return parts[0] if len(parts) > 1 else ""


def imports(path):
    """Dotted names of all that a file imports, also inside functions."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} has a relative import, which this test does not follow"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def imported_packages(path):
    """Packages of the library that a file imports."""
    own = [name.split(".") for name in imports(path) if name.split(".")[0] == "ppt_rl"]
    return {parts[1] for parts in own if len(parts) > 1 and parts[1] in ALLOWED}


def users(library):
    """Files that import an outside library."""
    return {str(p.relative_to(ROOT)) for p in FILES if library in {name.split(".")[0] for name in imports(p)}}


def test_the_library_consists_of_these_packages():
    found = {path.parent.name for path in (ROOT / "ppt_rl").glob("*/__init__.py")}
    assert found == set(ALLOWED)


@pytest.mark.parametrize("name", ALLOWED)
def test_a_package_imports_only_those_below_it(name):
    files = [path for path in FILES if package(path) == name]
    assert files
    for path in files:
        assert imported_packages(path) - {name} <= ALLOWED[name], path


def test_envs_and_transforms_do_not_import_each_other():
    seen = {"envs": set(), "transforms": set()}
    for path in FILES:
        if package(path) in seen:
            seen[package(path)] |= imported_packages(path)
    assert "transforms" not in seen["envs"]
    assert "envs" not in seen["transforms"]


def test_the_library_does_not_import_what_uses_it():
    outside = {"recipes", "benchmarks", "examples", "tests"} | {path.stem for path in (ROOT / "recipes").glob("*.py")}
    for path in FILES:
        assert not {name.split(".")[0] for name in imports(path)} & outside, path
        assert not [name for name in imports(path) if name.startswith(("ppt_rl.recipes", "ppt_rl.pretrained"))], path


def test_only_the_command_line_and_the_package_itself_stand_above_the_tasks():
    top = {path.name: imported_packages(path) for path in FILES if not package(path)}
    assert set(top) == {"__init__.py", "__main__.py", "cli.py", "collide_command.py", "commands.py", "view_command.py"}
    assert set().union(*top.values()) <= {"training", "evaluation", "view"}
    for name in ("training", "evaluation"):
        files = [path for path in FILES if package(path) == name]
        assert not [path for path in files if {"tasks"} & imported_packages(path)]


def test_training_knows_no_task_and_no_environment_of_ours():
    words = {"push", "maze", "box", "corridor"}
    for path in (path for path in FILES if package(path) == "training"):
        names = {node.id for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Name)}
        assert not {name for name in names for word in words if word in name.lower()}, path


@pytest.mark.parametrize("task", ["push", "maze"])
def test_a_task_does_not_import_another(task):
    others = {"push", "maze"} - {task}
    for path in FILES:
        if task in path.relative_to(ROOT / "ppt_rl").parts[:-1]:
            assert not [n for n in imports(path) for o in others if f".{o}." in f".{n}."], path


def test_recipes_import_the_library_and_nothing_beside_them():
    for path in (ROOT / "recipes").glob("ppo_*.py"):
        own = {name for name in imports(path) if name.startswith("ppt_rl")}
        assert own, path
        assert not [name for name in own if name.startswith(("ppt_rl.recipes", "ppt_rl.cli", "ppt_rl.commands"))], path


def test_no_package_imports_itself_by_way_of_another():
    graph = {name: set() for name in ALLOWED}
    for path in FILES:
        if package(path):
            graph[package(path)] |= imported_packages(path) - {package(path)}
    order = list(TopologicalSorter(graph).static_order())  # raises on a cycle
    assert set(order) == set(ALLOWED)
    assert graph["training"], "the walk finds imports"


@pytest.mark.parametrize("library", ["mujoco", "dm_control"])
def test_the_simulator_is_imported_by_the_environments_only(library):
    assert users(library)
    assert all(path.startswith("ppt_rl/envs/") for path in users(library))
