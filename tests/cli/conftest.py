"""The small slope."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers.small_slope import Slope, heights, release_box


@pytest.fixture
def slope(tmp_path: Path) -> Slope:
    made = Slope(tmp_path)
    made.write_config()
    made.write_dem(heights())
    made.write_release(release_box())
    return made
