"""What reaches exposed objects, from counts by hand."""

from __future__ import annotations

import numpy as np
import pytest

from sassgis.hazard.object_values import object_values
from sassgis.settings.hazard_rules import Source, SourceCounts
from sassgis.settings.map_run import ObjectCells
from sassgis.settings.statistics_table import SUMS, default_bins
from sassgis.simulation.map_sums import MapSums

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


@pytest.mark.parametrize(("count", "square"), [(100, 2000), (99, 1961), (50, 500)])
def test_limits_of_heights_are_those_of_the_blocks_that_arrive(count: int, square: int) -> None:
    """Heights evenly up to 10 m: of all blocks of five points, of all but one, of every second."""
    edges = default_bins().edges
    sums = {
        s.name: np.zeros((1, *((edges[s.name].size - 1,) if s.name in edges else ())), s.dtype)
        for s in SUMS
    }
    sums["height"][0] = np.histogram(np.linspace(0.0, 10.0, 1000), edges["height"])[0]
    sums["reach"][0], sums["height_max"][0] = 1000, 10.0
    cells = MapSums(4)
    cells.add(np.array([3]), sums)
    counts, squares = np.array([[count, 0, 0]]), np.array([[square, 0, 0]])
    found = object_values(
        ObjectCells(1, np.array([3]), np.array([0])),
        [Source("A", "m", 0.5, 100, 20)],
        [SourceCounts(np.array([0]), counts, squares)],
        ENERGIES, cells, edges["height"],
    )  # fmt: skip
    value, low, high = found.height_q95_m.of(0)
    room = 10.0 * 1.96 * np.sqrt(0.95 * 0.05 / count)
    assert value == pytest.approx(9.5, abs=0.1)
    assert (value - low, high - value) == pytest.approx((room, min(room, 0.5)), abs=0.1)
