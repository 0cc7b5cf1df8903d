"""The benchmark slope is the one that is described, and SAGA is timed or named as absent."""

from __future__ import annotations

from pathlib import Path

import geopandas as gpd
import numpy as np
import pytest
import rasterio
import saga
import slope

from sassgis.inputs.config import load_config
from sassgis.terrain.release import release_points


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("plain")
    slope.write_slope(folder)
    return folder


def test_there_are_3000_release_points_and_each_is_a_cell_centre(plain: Path) -> None:
    config = load_config(plain / "config.toml")
    areas = gpd.read_file(config.release_source)
    points = release_points(list(zip(areas["name"], areas.geometry, strict=True)), config.release)
    assert len(points) == slope.RELEASE_CELLS == 3000
    with rasterio.open(plain / "dem.tif") as raster:
        cols = (points.x - raster.bounds.left) / raster.res[0] - 0.5
        rows = (raster.bounds.top - points.y) / raster.res[1] - 0.5
    assert np.array_equal(cols, np.round(cols)) and np.array_equal(rows, np.round(rows))
    down = points.x - slope.WEST
    assert slope.borders()[1] < down.min() and down.max() < slope.borders()[2]


def test_saga_is_named_when_it_is_absent(plain: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(saga, "PROGRAM", "no_such_program")
    result = saga.measure(plain, repeats=1)
    assert result["available"] is False
    assert "apt-get install saga" in result["message"]


def test_saga_walks_run_out_over_the_talus(plain: Path) -> None:
    if saga.version() is None:
        pytest.skip(saga.ABSENT)
    result = saga.measure(plain, repeats=1, iterations=3)
    assert result["release_cells"] == 3000
    assert result["walks"] == 9000
    assert result["stop_chainage"]["stops"] == 9000
    # How fast is no matter of a test: on a busy machine the set-up alone may take longer.
    assert {"walks_per_s", "walks_per_cpu_s"} <= set(result)
    assert slope.borders()[3] < result["stop_chainage"]["p50_m"] < slope.borders()[4]
