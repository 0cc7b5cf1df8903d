"""Small input files, made where they are needed."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.input_files import LV95, NORTH, WEST, make_dem, make_layer

from sassgis.grid import Grid
from sassgis.settings.crs import parse_crs

__all__ = ["make_dem", "make_layer"]


@pytest.fixture
def slope_grid() -> Grid:
    """20 rows x 30 columns of 10 m, falling to the south at 45 degrees."""
    rows = np.arange(20, dtype=float)[:, None]
    values = np.broadcast_to(1000.0 - 10.0 * rows, (20, 30)).copy()
    return Grid(values, WEST, NORTH, 10.0, parse_crs(LV95).to_wkt(), "LN02")
