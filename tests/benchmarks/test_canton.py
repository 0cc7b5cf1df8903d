"""The synthetic canton is the one that is described."""

from __future__ import annotations

from pathlib import Path

import canton
import geopandas as gpd
import numpy as np
import pytest

from sassgis.inputs.config import load_config
from sassgis.inputs.tiles import Part, open_terrain
from sassgis.settings.settings import ReleaseSettings
from sassgis.terrain.release import release_points


def test_a_share_has_its_cells_areas_and_points(tmp_path: Path) -> None:
    whole = canton.Canton(canton.KM2, 5.0, canton.AREAS, 100, 10)
    assert whole.cells == 120_000_000
    small = canton.Canton(25.0, 5.0, 10, 100, 10)
    canton.write_canton(small, tmp_path)
    terrain = open_terrain(tmp_path / "tiles")
    assert terrain.whole == Part(0, 0, 1000, 1000)
    areas = gpd.read_file(load_config(tmp_path / "config.toml").release_source)
    points = release_points(
        list(zip(areas["name"], areas.geometry, strict=True)), ReleaseSettings(spacing_m=5.0)
    )
    assert np.bincount(points.area).tolist() == [100] * 10
    assert areas.intersection(areas.union_all()).area.sum() == pytest.approx(areas.area.sum())
    # All points lie in the cliff, which is steeper than 50 degrees in the mean.
    grid = terrain.read(terrain.whole)
    rows, cols = np.divmod(grid.cell_of(points.x, points.y), 1000)
    rise = np.hypot(*np.gradient(grid.values, 5.0))[rows, cols]
    assert np.degrees(np.arctan(rise)).mean() > 50.0
