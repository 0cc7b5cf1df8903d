"""Scripts run in the process of the tests: the packages that they import are loaded already."""

from __future__ import annotations

import contextlib
import importlib.util
import io
import runpy
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import pytest


@dataclass(frozen=True)
class Done:
    """How a script ended."""

    code: int
    out: str
    err: str


def run_script(script: Path, *arguments: object) -> Done:
    """Run a file as ``python FILE ARGUMENTS...`` would."""
    out, err = io.StringIO(), io.StringIO()
    code: object = 0
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", [str(script), *map(str, arguments)])
        patch.setattr(sys, "path", [str(script.parent), *sys.path])
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            try:
                runpy.run_path(str(script), run_name="__main__")
            except SystemExit as stop:
                code = stop.code
    if isinstance(code, str):
        return Done(1, out.getvalue(), err.getvalue() + code + "\n")
    return Done(code if isinstance(code, int) else 0, out.getvalue(), err.getvalue())


def load(path: Path) -> ModuleType:
    """Import a file that is in no package."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # Dataclasses look their module up.
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    return module
