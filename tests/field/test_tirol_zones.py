"""Hazard zones on real terrain in Tyrol: 5 m, more than half of it unknown.

The polygons were drawn for snow avalanches and the frequencies are invented: what is checked is the
drawing, not the hazard.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import rasterio
import shapely

pytestmark = pytest.mark.battery

#: Terrain model, release polygons, distance between release points (m).
DEM, RELEASE, SPACING = "tirol_avaGar/avaGar.asc", "tirol_avaGar/REL/relGar.shp", 20.0
LEVELS = ["residual_hazard", "slight", "mean", "substantial"]
#: Runs the zoning and tells its peak memory (KiB on Linux).
MEASURED = """
import resource, sys
from sassgis.runs.run import zone
zone(sys.argv[1], sys.argv[2], jobs=2)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def config_text(folder: Path) -> str:
    return f"""
[terrain]
dem = {json.dumps(str(folder / DEM))}
crs = "EPSG:31287"
[release]
file = {json.dumps(str(folder / RELEASE))}
spacing_m = {SPACING}
rocks_per_point = 10
[ground]
default = "debris"
[hazard]
ref_width_m = 10.0
[[blocks]]
name = "small"
axis_1_m = [0.2, 0.35]
axis_2_m = [0.2, 0.3]
axis_3_m = [0.15, 0.25]
onset_frequency = 3.0
[[blocks]]
name = "1 m3"
axis_1_m = [0.65, 0.85]
axis_2_m = [0.55, 0.70]
axis_3_m = [0.45, 0.60]
onset_frequency = 0.3
"""


@pytest.fixture(scope="module")
def made(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, int]:
    """Folder of the result, peak memory (MiB)."""
    if not (shared_data / DEM).is_file():
        pytest.skip(f"{DEM} is not in the folder of the field data")
    folder = tmp_path_factory.mktemp("zones")
    config = folder / "config.toml"
    config.write_text(config_text(shared_data), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-c", MEASURED, str(config), str(folder / "result")],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    return folder / "result", int(done.stdout.split()[-1]) // 1024


def test_memory_stays_small(made: tuple[Path, int]) -> None:
    if not sys.platform.startswith("linux"):
        pytest.skip("peak memory is told in KiB on Linux only")
    assert made[1] < 2000


def test_zones_are_whole_and_on_known_terrain(made: tuple[Path, int]) -> None:
    folder = made[0]
    zones = gpd.read_file(folder / "hazard.gpkg", layer="hazard_zones")
    assert zones.crs.to_epsg() == 31287
    polygons = shapely.get_parts(np.array(zones.geometry))
    assert len(polygons) == len(zones) > 3
    assert shapely.is_valid(polygons).all() and shapely.coverage_is_valid(polygons)
    assessed = gpd.read_file(folder / "hazard.gpkg", layer="assessment_area").union_all()
    assert shapely.union_all(polygons).difference(assessed).area == pytest.approx(0.0, abs=1e-6)
    # No speckle: nothing smaller than the smallest area, nothing as narrow as a fall line.
    assert zones.geometry.area.min() >= 100.0 - 1e-6
    outline = zones.union_all()
    opened = outline.buffer(-4.0).buffer(4.5)
    assert outline.difference(opened).area < 0.03 * outline.area


def test_zones_are_not_below_the_cells(made: tuple[Path, int]) -> None:
    folder = made[0]
    with rasterio.open(folder / "maps" / "hazard_level.tif") as file:
        level = file.read(1, masked=True).filled(0)
        rows, cols = np.nonzero(level)
        x, y = rasterio.transform.xy(file.transform, rows, cols)
    with rasterio.open(folder / "maps" / "terrain.tif") as file:
        assert not file.read(1, masked=True).mask[rows, cols].any()
    zones = gpd.read_file(folder / "hazard.gpkg", layer="hazard_zones")
    drawn = np.zeros(rows.size, np.int64)
    for geometry, code in zip(zones.geometry, zones["hazard_level"], strict=True):
        inside = shapely.intersects_xy(geometry, x, y)
        drawn[inside] = np.maximum(drawn[inside], LEVELS.index(code) + 1)
    assert rows.size > 500 and np.all(drawn >= level[rows, cols])
    table = pd.read_csv(folder / "tables" / "zones.csv")
    assert table["cells"].sum() == rows.size
    assert np.allclose(table["area_m2"], zones.geometry.area, atol=0.06)
