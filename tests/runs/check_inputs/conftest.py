"""The fixtures that write input files, and the small slope."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers.input_files import make_dem, make_layer
from helpers.small_slope import Slope

__all__ = ["make_dem", "make_layer"]


@pytest.fixture
def slope(tmp_path: Path) -> Slope:
    """A configuration with everything that a run needs."""
    return Slope.made(tmp_path)
