"""Results with hazard zones, as a run would leave them."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from helpers import made_zones

from sassgis.outputs.geopackage import write_geopackage


def _write(folder: Path, **changes: Any) -> Path:
    (folder / "manifest.json").write_text("{}")
    write_geopackage(folder / "hazard.gpkg", made_zones.some_layers(**changes))
    return folder


@pytest.fixture(scope="session")
def made_once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _write(tmp_path_factory.mktemp("result"))


@pytest.fixture
def make_result(tmp_path: Path) -> Callable[..., Path]:
    """Write a result folder with changes; returns it."""
    (tmp_path / "result").mkdir()
    return lambda **changes: _write(tmp_path / "result", **changes)


@pytest.fixture
def result(made_once: Path, tmp_path: Path) -> Path:
    return shutil.copytree(made_once, tmp_path / "result")
