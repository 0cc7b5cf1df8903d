"""The small slope."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers.small_slope import Slope


@pytest.fixture
def slope(tmp_path: Path) -> Slope:
    return Slope.made(tmp_path)
