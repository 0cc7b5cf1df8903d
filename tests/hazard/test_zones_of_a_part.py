"""Zones of places that lie apart are those of each place by itself, on any part of a grid."""

from __future__ import annotations

import numpy as np
import shapely

from sassgis.grid import Grid
from sassgis.hazard.assess import intensity_maps
from sassgis.hazard.zoning.drawing import reach_cells
from sassgis.inputs.presets import read_preset
from sassgis.settings.hazard_rules import HazardCurves, ZoningSettings
from sassgis.terrain.release import release_rims

CELL = 2.0
PRESET = read_preset("ch-so")
RULES = ZoningSettings().drawing(PRESET.sheet, 5.0, 0.0, CELL)


def curves(rng: np.random.Generator, row: int, col: int, n_cols: int) -> HazardCurves:
    rows, cols = np.nonzero(rng.random((20, 25)) < 0.3)
    places = np.sort((rows + row) * n_cols + cols + col)
    energies = np.array(PRESET.thresholds_kj)
    rate = np.cumsum(rng.random((places.size, energies.size))[:, ::-1], axis=1)[:, ::-1] * 0.01
    return HazardCurves(places, energies, rate, np.zeros_like(rate), np.zeros(places.size))


def test_places_that_lie_apart_do_not_feel_each_other() -> None:
    rng = np.random.default_rng(3)
    beside = 2 * reach_cells(RULES, CELL)
    n_cols = 150 + beside
    grid = Grid(np.ones((160, n_cols)), 2_600_000.0, 1_200_000.0, CELL)
    grid.values[rng.integers(0, 160, 200), rng.integers(0, n_cols, 200)] = np.nan
    one, other = curves(rng, 70, 90, n_cols), curves(rng, 100, 115 + beside, n_cols)
    order = np.argsort(np.concatenate((one.places, other.places)))
    names = ("places", "rate", "variance", "rate_of_a_rock")
    places, *values = (np.concatenate((getattr(one, n), getattr(other, n)))[order] for n in names)
    both = HazardCurves(places, one.energies_kj, *values)
    together = intensity_maps(both, PRESET, grid, RULES)
    alone = [intensity_maps(c, PRESET, grid, RULES) for c in (one, other)]
    for years, zones in together.items():
        parts = {shapely.normalize(p).wkb for own in alone for p in own[years].polygons}
        assert parts == {shapely.normalize(p).wkb for p in zones.polygons}
    assert together[None].polygons.size


def test_a_release_area_has_the_level_of_the_rim_below_it() -> None:
    # A plane that falls to the south; the western half of what leaves the area is high.
    n_rows, n_cols = 40, 60
    heights = np.repeat(-np.arange(n_rows, dtype=float)[:, None], n_cols, axis=1)
    grid = Grid(heights, 0.0, n_rows * CELL, CELL)
    area = shapely.box(20 * CELL, 25 * CELL, 40 * CELL, 35 * CELL)
    cells, rim = release_rims([area], grid)
    row, col = np.divmod(cells, n_cols)
    assert row.min() == 5 and row.max() == 14 and cells.size == 200
    assert (rim == 15 * n_cols + col).all()
    assert release_rims([shapely.LineString([(10, 10), (50, 50)])], grid).size == 0
    assert release_rims([shapely.box(-90, -90, -80, -80)], grid).size == 0
    # Blocks come to the rim only, often: the intensities of 30 years.
    places = np.arange(15 * n_cols + 20, 15 * n_cols + 40)
    energies = np.array(PRESET.thresholds_kj)
    often = HazardCurves(
        places, energies, np.ones((20, energies.size)), np.zeros((20, energies.size)), np.ones(20)
    )
    plain = ZoningSettings(tolerance_m=0.0).drawing(None, 5.0, 0.0, CELL)
    bare = intensity_maps(often, PRESET, grid, plain)[30.0]
    filled = intensity_maps(often, PRESET, grid, plain, np.stack([cells, rim]))[30.0]
    assert shapely.area(bare.polygons).sum() == 20 * CELL**2
    covered = shapely.union_all(filled.polygons)
    assert covered.area == (200 + 20) * CELL**2 and covered.covers(area)
