"""Zones drawn on the part of a grid around what is reached are those of the whole grid."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from sassgis.hazard.assess import intensity_maps
from sassgis.hazard.levels import intensity_class
from sassgis.hazard.zoning.generalise import generalised_series, nested_coverages
from sassgis.io.read.presets import read_preset
from sassgis.model.grid import Grid
from sassgis.model.hazard import HazardCurves, ZoningSettings


@pytest.mark.parametrize("corner", [(0, 0), (70, 90), (140, 175)])
@pytest.mark.parametrize("seed", range(3))
def test_the_part_changes_nothing(corner: tuple[int, int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    grid = Grid(np.ones((160, 200)), 2_600_000.0, 1_200_000.0, 2.0)
    grid.values[rng.integers(0, 160, 200), rng.integers(0, 200, 200)] = np.nan
    rows, cols = np.nonzero(rng.random((20, 25)) < 0.3)
    places = np.sort((rows + corner[0]) * 200 + cols + corner[1])
    preset, settings = read_preset("ch-so"), ZoningSettings()
    energies = np.array(preset.thresholds_kj)
    rate = np.cumsum(rng.random((places.size, energies.size))[:, ::-1], axis=1)[:, ::-1] * 0.01
    curves = HazardCurves(places, energies, rate, np.zeros_like(rate), np.zeros(places.size))
    years = [*preset.return_periods, None]
    known = np.isfinite(grid.values)
    maps = []
    for t in years:
        own = np.zeros(grid.values.size, np.int64)
        own[places] = intensity_class(curves, preset, t)
        maps.append(own.reshape(grid.shape))
    smooth = generalised_series(maps, grid.cell_size, settings, known)
    want = nested_coverages(smooth, grid, settings, known)
    found = intensity_maps(curves, preset, grid, settings)
    assert [f.years for f in found] == years and len(want[-1].polygons)
    for one, two in zip(want, found, strict=True):
        assert np.array_equal(one.classes, two.zones.classes)
        assert shapely.to_wkb(one.polygons).tolist() == shapely.to_wkb(two.zones.polygons).tolist()
