"""Results with hazard zones, as a run would leave them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from helpers import made_zones

from sassgis.outputs.geopackage import write_geopackage


@pytest.fixture
def make_result(tmp_path: Path) -> Callable[..., Path]:
    """Write a result folder; returns it."""

    def make(**changes: Any) -> Path:
        folder = tmp_path / "result"
        folder.mkdir()
        (folder / "manifest.json").write_text("{}")
        write_geopackage(folder / "hazard.gpkg", made_zones.some_layers(**changes))
        return folder

    return make


@pytest.fixture
def result(make_result: Callable[..., Path]) -> Path:
    return make_result()
