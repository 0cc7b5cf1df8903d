"""Scripts beside the package import nothing that the package does not have."""

from __future__ import annotations

import ast
import importlib
from pathlib import Path

import pytest

FOLDERS = ("pipelines", "benchmarks", "docs", "sample_dem", "qgis_plugin")
SCRIPTS = sorted(
    file.relative_to(root).as_posix()
    for root in [Path(__file__).resolve().parents[2]]
    for folder in FOLDERS
    for file in (root / folder).rglob("*.py")
    if "import sassgis" in file.read_text(encoding="utf-8")
    or "from sassgis" in file.read_text(encoding="utf-8")
)


@pytest.mark.parametrize("script", SCRIPTS)
def test_what_a_script_imports_is_there(repository: Path, script: str) -> None:
    tree = ast.parse((repository / script).read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "sassgis":
            module = importlib.import_module(str(node.module))
            for name in node.names:
                if not hasattr(module, name.name):
                    importlib.import_module(f"{node.module}.{name.name}")
