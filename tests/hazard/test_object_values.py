"""What reaches exposed objects, from counts by hand."""

from __future__ import annotations

import numpy as np
import pytest

from sassgis.hazard.object_values import object_values
from sassgis.model.hazard import Source, SourceCounts
from sassgis.model.map_run import ObjectCells

ENERGIES = np.array([0.0, 30.0, 300.0])


@pytest.mark.filterwarnings("error")
def test_an_object_that_only_blocks_released_never_reach_has_no_energies() -> None:
    counts = np.array([[6, 2, 1]])
    reached = SourceCounts(np.array([0]), counts, counts)
    objects = ObjectCells(1, np.array([3]), np.array([0]))
    found = object_values(
        objects, [Source("A", "m", 0.0, 20, 4)], [reached], ENERGIES, None, ENERGIES,
        return_periods=(30.0,),
    )  # fmt: skip
    assert found.arrivals.of(0) == (0.0, 0.0, 0.0)
    assert np.isnan([found.energy_q95_kj.of(0), found.energy_kj[30.0].of(0)]).all()
