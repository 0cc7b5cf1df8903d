"""A small terrain and small layers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pytest
import shapely
from helpers.worked_example import COUNTS, ENERGIES, HOUSE, ROAD, SOURCES, vulnerability

from sassgis.grid import Grid
from sassgis.hazard.risk import RiskTable, assess_risk
from sassgis.settings.crs import parse_crs

WEST, NORTH, CELL = 2_700_000.0, 1_150_000.0, 2.0


@pytest.fixture(scope="session")
def grid() -> Grid:
    """400 by 300 m of plain slope, with a patch of nodata in the south-east."""
    values = np.add.outer(np.linspace(1200.0, 1000.0, 150), np.zeros(200))
    values[120:, 170:] = np.nan
    return Grid(values, WEST, NORTH, CELL, parse_crs("EPSG:2056").to_wkt())


@pytest.fixture
def layer(tmp_path: Path) -> Callable[..., Path]:
    """Write shapes, given in metres from the north-western corner with y downwards."""

    def make(
        shapes: Sequence[Any], name: str = "objects.gpkg", to: str | None = None, **columns: Any
    ) -> Path:
        moved = [
            None if s is None else shapely.transform(s, lambda p: p * [1.0, -1.0] + [WEST, NORTH])
            for s in shapes
        ]
        frame = gpd.GeoDataFrame(columns, geometry=moved, crs="EPSG:2056")
        path = tmp_path / name
        (frame if to is None else frame.to_crs(to)).to_file(path)
        return path

    return make


@pytest.fixture(scope="session")
def example() -> RiskTable:
    return assess_risk((HOUSE, ROAD), SOURCES, COUNTS, ENERGIES, ENERGIES, vulnerability())
