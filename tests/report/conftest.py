from __future__ import annotations

import numpy as np
import pytest

from sassgis.grid import Grid


@pytest.fixture
def valley() -> Grid:
    """A side that falls to the south by 1 in 2, with a gap in the north-east."""
    y, _ = np.mgrid[0:40, 0:60] * 5.0
    z = 1000.0 - 0.5 * y
    z[:6, -8:] = np.nan
    return Grid(z, 2_700_000.0, 1_150_000.0, 5.0)
