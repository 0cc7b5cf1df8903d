"""Small input files, made where they are needed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from helpers.input_files import LV95, NORTH, WEST, make_dem, make_layer

from sassgis.model.crs import parse_crs
from sassgis.model.errors import InputError
from sassgis.model.grid import Grid

__all__ = ["make_dem", "make_layer"]


@pytest.fixture
def slope_grid() -> Grid:
    """20 rows x 30 columns of 10 m, falling to the south at 45 degrees."""
    rows = np.arange(20, dtype=float)[:, None]
    values = np.broadcast_to(1000.0 - 10.0 * rows, (20, 30)).copy()
    return Grid(values, WEST, NORTH, 10.0, parse_crs(LV95).to_wkt(), "LN02")


@pytest.fixture
def one_line() -> Callable[..., None]:
    """Check that an error is one line that holds all the words given."""

    def check(error: pytest.ExceptionInfo[InputError], *words: object) -> None:
        text = str(error.value)
        assert "\n" not in text
        missing = [str(w) for w in words if str(w) not in text]
        assert not missing, f"{missing} not in: {text}"

    return check
