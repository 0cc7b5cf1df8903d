"""Fixtures of the tests of the gap: a plane slope, and what was observed on it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.observed_slope import LV95, NORTH, TABLES, TAN, TOP, WEST
from helpers.simulated_slope import observed
from threadpoolctl import threadpool_limits

from sassgis.gap.fit.site_data import SiteData, site_data_of
from sassgis.grid import Grid
from sassgis.settings.crs import parse_crs


@pytest.fixture(scope="session", autouse=True)
def one_thread() -> Iterator[None]:
    """Small products of matrices: threads of the linear algebra would only wait for each other."""
    with threadpool_limits(1, "blas"):
        yield


@pytest.fixture(scope="session")
def slope() -> Grid:
    """200 m wide, 300 m down, cells of 2 m."""
    y = (np.arange(150) + 0.5) * 2.0
    heights = np.repeat((TOP - TAN * y)[:, None], 100, axis=1)
    return Grid(heights, WEST, NORTH, 2.0, crs=parse_crs(LV95).to_wkt())


@pytest.fixture
def folder(tmp_path: Path) -> Callable[..., Path]:
    """Write the tables as CSV, changed by functions of their rows; None leaves one out."""

    def write(**changes: Any) -> Path:
        path = tmp_path / "observed"
        path.mkdir(exist_ok=True)
        for name, (header, rows) in TABLES.items():
            change = changes.pop(name, lambda rows: rows)
            if change is None:
                continue
            columns = header.split(",")
            records = [dict(zip(columns, row, strict=True)) for row in rows]
            records = change(records) or records
            keys = list(records[0]) if records and isinstance(records[0], dict) else columns
            lines = [",".join(keys), *(",".join(str(r[k]) for k in keys) for r in records)]
            (path / f"{name}.csv").write_text("\n".join(lines) + "\n")
        assert not changes
        return path

    return write


@pytest.fixture(scope="session")
def problem() -> SiteData:
    """Of rocks that the engine released without any effect."""
    return site_data_of(observed(24, 3), 5)
