"""The package and its tests have the same rooms, and nothing is found under one name twice."""

from __future__ import annotations

import ast
from collections import Counter
from pathlib import Path

import pytest

pytestmark = pytest.mark.e2e

#: Folders of tests for what is not in the package.
OTHERS = {"benchmarks", "docs", "e2e", "field", "helpers", "pipelines", "qgis_plugin", "sample_dem"}
LONGEST_FUNCTION = 130


@pytest.fixture(scope="module")
def modules(repository: Path) -> dict[Path, ast.Module]:
    files = sorted((repository / "sassgis").rglob("*.py"))
    return {p: ast.parse(p.read_text(encoding="utf-8")) for p in files}


def test_folders_of_tests_are_those_of_the_package(repository: Path) -> None:
    tests, package = repository / "tests", repository / "sassgis"
    for file in tests.rglob("test_*.py"):
        room = file.parent.relative_to(tests)
        if room.parts[0] not in OTHERS:
            assert (package / room).is_dir() or (package / room).with_suffix(".py").is_file(), file


def test_no_file_name_is_there_twice(modules: dict[Path, ast.Module]) -> None:
    names = Counter(p.name for p in modules if not p.name.startswith("__"))
    assert [name for name, count in names.items() if count > 1] == []


def test_no_public_class_name_is_there_twice(modules: dict[Path, ast.Module]) -> None:
    bodies = [node for tree in modules.values() for node in tree.body]
    names = Counter(n.name for n in bodies if isinstance(n, ast.ClassDef) and n.name[0] != "_")
    assert [name for name, count in names.items() if count > 1] == []


def lines_of(function: ast.FunctionDef) -> int:
    """Lines of a function without its docstring."""
    first = function.body[0]
    assert function.end_lineno is not None and first.end_lineno is not None
    documented = ast.get_docstring(function) is not None
    text = first.end_lineno - first.lineno + 1 if documented else 0
    return function.end_lineno - function.lineno + 1 - text


def test_no_function_is_longer_than_a_reader_can_hold_in_mind(
    modules: dict[Path, ast.Module],
) -> None:
    long = [
        f"{path.name}: {node.name}, {lines_of(node)} lines"
        for path, tree in modules.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef) and lines_of(node) > LONGEST_FUNCTION
    ]
    assert long == []
