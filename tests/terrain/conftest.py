"""Fixtures of the terrain tests."""

from __future__ import annotations

import pytest
from helpers.terrains import grid_of, rough

from sassgis.grid import Grid


@pytest.fixture(scope="session")
def rough_grid() -> Grid:
    return grid_of(rough, 120, 140)
