"""Shares of the sources in the zones."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from sassgis.grid import Grid
from sassgis.hazard.assess import attribution, governing, shares_by, zone_of_cells
from sassgis.hazard.zoning.coverage import Coverage
from sassgis.hazard.zoning.drawing import drawn_zones
from sassgis.settings.hazard_rules import Drawing, Source, SourceCounts


def source(area: str, scenario: str, frequency: float, rocks: int = 100) -> Source:
    return Source(area, scenario, frequency, rocks, 10)


def counts(places: list[int], rows: list[list[int]]) -> SourceCounts:
    table = np.array(rows, np.int64).reshape(len(places), -1)
    return SourceCounts(np.array(places, np.int64), table, table**2)


def test_shares_are_those_of_the_rates() -> None:
    sources = [
        source("A", "small", 1.0, 100),
        source("A", "large", 0.1, 50),
        source("B", "small", 0.5, 100),
    ]
    found = [
        counts([3, 4], [[10, 5], [8, 2]]),
        counts([4, 7], [[20, 20], [9, 1]]),
        counts([9], [[4, 3]]),
    ]
    cells = np.array([3, 4, 7, 9])
    shares = attribution(np.array([0, 0, 2, -1]), cells, sources, found, np.array([0, 1, 0, 0]), 3)
    # Zone 0: 0.01 * (10 + 2) of the first, 0.002 * 20 of the second.
    np.testing.assert_allclose(shares[0], [0.12 / 0.16, 0.04 / 0.16, 0.0])
    assert np.isnan(shares[1]).all()
    np.testing.assert_allclose(shares[2], [0.0, 1.0, 0.0])
    index, share = governing(shares)
    assert index.tolist() == [0, -1, 1]
    np.testing.assert_allclose(share, [0.75, np.nan, 1.0])
    areas, by_area = shares_by(shares, ["A", "A", "B"])
    assert areas == ("A", "B")
    np.testing.assert_allclose(by_area, [[1.0, 0.0], [np.nan, np.nan], [1.0, 0.0]])
    scenarios, by_scenario = shares_by(shares, [s.scenario for s in sources])
    assert scenarios == ("small", "large")
    np.testing.assert_allclose(by_scenario[0], [0.75, 0.25])


def test_places_that_are_no_cells_of_zones_do_not_count() -> None:
    sources = [source("A", "s", 1.0)]
    found = [counts([1, 5, 99], [[1], [2], [50]])]
    cells = np.array([5, 6])
    shares = attribution(np.array([0, 0]), cells, sources, found, np.zeros(2, np.int64), 1)
    assert shares.tolist() == [[1.0]]
    none = np.empty(0, np.int64)
    assert np.isnan(attribution(none, none, sources, found, none, 2)).all()
    with pytest.raises(ValueError, match="ascending"):
        attribution(np.array([0, 0]), cells[::-1], sources, found, np.zeros(2, np.int64), 1)


def test_nothing_governs_without_sources() -> None:
    index, share = governing(np.empty((2, 0)))
    assert index.tolist() == [-1, -1]
    assert np.isnan(share).all()
    index, _ = governing(np.array([[0.5, 0.5]]))
    assert index.tolist() == [0]
    assert shares_by(np.empty((2, 0)), [])[1].shape == (2, 0)


@settings(max_examples=50)
@given(st.integers(0, 10_000), st.integers(1, 5), st.integers(1, 6))
def test_shares_add_up_and_do_not_depend_on_the_unit_of_frequency(
    seed: int, n_sources: int, n_zones: int
) -> None:
    rng = np.random.default_rng(seed)
    cells = np.sort(rng.choice(200, 60, replace=False))
    found = []
    for _ in range(n_sources):
        places = np.sort(rng.choice(200, 40, replace=False))
        table = -np.sort(-rng.integers(0, 30, (40, 3)), axis=1)
        found.append(SourceCounts(places, table, table**2))
    frequency = rng.uniform(0.01, 2.0, n_sources)
    zone = rng.integers(-1, n_zones, cells.size)
    column = rng.integers(0, 3, cells.size)

    def shares(factor: float) -> np.ndarray:
        sources = [source(f"{i}", "s", factor * f) for i, f in enumerate(frequency)]
        return attribution(zone, cells, sources, found, column, n_zones)

    once = shares(1.0)
    total = once.sum(axis=1)
    assert ((abs(total - 1.0) < 1e-12) | np.isnan(total)).all()
    np.testing.assert_allclose(shares(8.0), once, rtol=1e-12)
    # By hand, cell by cell.
    rate = np.zeros((n_zones, n_sources))
    for s, count in enumerate(found):
        for cell, z, j in zip(cells, zone, column, strict=True):
            if z >= 0 and cell in count.places:
                row = int(np.flatnonzero(count.places == cell)[0])
                rate[z, s] += frequency[s] / 100 * count.count[row, j]
    reached = rate.sum(axis=1) > 0
    np.testing.assert_allclose(
        once[reached], rate[reached] / rate[reached].sum(axis=1, keepdims=True), rtol=1e-12
    )
    assert np.isnan(once[~reached]).all()


def test_cells_find_the_zone_that_holds_their_centre() -> None:
    i, j = np.mgrid[:40, :40]
    classes = (np.hypot(i - 20, j - 20) < 15).astype(np.int64)
    classes += (j > i + 4) & (classes > 0)
    grid = Grid(np.zeros(classes.shape), 2_700_000.0, 1_120_000.0, 2.0)
    (zones,) = drawn_zones([classes], grid, Drawing())
    cells = np.arange(classes.size)
    found = zone_of_cells(zones, grid, cells)
    x, y = grid.cell_centres(cells)
    for cell, zone in enumerate(found):
        point = shapely.Point(x[cell], y[cell])
        touching = [k for k, p in enumerate(zones.polygons) if p.intersects(point)]
        if not touching:
            assert zone == -1
        else:
            assert zone in touching
            assert zones.classes[zone] == zones.classes[touching].max()
    assert (zones.classes[found[classes.ravel() > 0]] >= classes[classes > 0]).all()


def test_a_centre_on_a_boundary_belongs_to_the_higher_class() -> None:
    grid = Grid(np.zeros((1, 3)), 0.0, 2.0, 2.0)
    zones = Coverage(
        np.array([shapely.box(0, 0, 3, 2), shapely.box(3, 0, 5, 2)], object), np.array([1, 2])
    )
    assert zone_of_cells(zones, grid, np.array([0, 1, 2])).tolist() == [0, 1, 1]
    none = Coverage(np.empty(0, object), np.empty(0, np.int64))
    assert zone_of_cells(none, grid, np.array([0, 1])).tolist() == [-1, -1]
    assert zone_of_cells(zones, grid, np.empty(0, np.int64)).size == 0
