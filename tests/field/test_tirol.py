"""Whole runs on real terrain in Tyrol: 5 m, a third of it nodata.

The polygons were drawn for snow avalanches. Here they are no more than places from which to let
rocks go: what is checked is that nothing gets lost between the files, not where rocks stop.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import rasterio
import shapely

from sassgis.runs.run import RunResult, run
from sassgis.settings.results import StopReason

pytestmark = pytest.mark.battery

#: Terrain model, release polygons, distance between release points (m).
PLACES = {
    "kot": ("tirol_avaKot/avaKot.asc", "tirol_avaKot/REL/relKot.shp", 20.0),
    "mal": ("tirol_avaMalRegional/avaMal.tif", "tirol_avaMalRegional/REL/relMalRegional.shp", 60.0),
}
ROCKS = 5


@dataclass(frozen=True)
class Case:
    result: RunResult
    rocks: pd.DataFrame
    footprint: gpd.GeoDataFrame
    counts: dict[str, int]

    def layer(self, name: str) -> gpd.GeoDataFrame:
        return gpd.read_file(self.result.folder / "result.gpkg", layer=name)


def config_text(folder: Path, dem: str, release: str, spacing: float, terrain: str = "") -> str:
    return f"""
[terrain]
dem = {json.dumps(str(folder / dem))}
crs = "EPSG:31287"
{terrain}
[release]
file = {json.dumps(str(folder / release))}
spacing_m = {spacing}
rocks_per_point = {ROCKS}
[ground]
default = "debris"
[[blocks]]
name = "1 m3"
axis_1_m = [0.65, 0.85]
axis_2_m = [0.55, 0.70]
axis_3_m = [0.45, 0.60]
[output]
rock_table = "csv"
"""


@pytest.fixture(scope="module", params=list(PLACES))
def case(
    request: pytest.FixtureRequest, shared_data: Path, tmp_path_factory: pytest.TempPathFactory
) -> Case:
    dem, release, spacing = PLACES[request.param]
    if not (shared_data / dem).is_file():
        pytest.skip(f"{dem} is not in the folder of the field data")
    folder = tmp_path_factory.mktemp(request.param)
    config = folder / "config.toml"
    config.write_text(config_text(shared_data, dem, release, spacing), encoding="utf-8")
    result = run(config, folder / "result")
    gpkg = result.folder / "result.gpkg"
    return Case(
        result,
        pd.read_csv(result.folder / "tables" / "rocks.csv"),
        gpd.read_file(gpkg, layer="footprint"),
        json.loads((result.folder / "manifest.json").read_text(encoding="utf-8"))["counts"],
    )


def test_no_rock_is_lost_without_a_count(case: Case) -> None:
    counts = case.counts
    released = ROCKS * counts["release_points"]
    assert released > 0
    assert counts["rocks"] + counts["rocks_not_simulated"] == released
    assert sum(counts[f"rocks_{r.name.lower()}"] for r in StopReason) == counts["rocks"]
    assert len(case.rocks) == counts["rocks"] == len(case.layer("stops"))
    assert int(case.layer("release_areas")["rocks"].sum()) == released
    in_table = case.rocks["reason"].value_counts()
    for reason in StopReason:
        name = reason.name.lower()
        assert in_table.get(name, 0) == counts[f"rocks_{name}"], name


def test_every_stop_lies_on_known_ground_and_in_the_footprint(case: Case) -> None:
    grid = case.result.run.grid
    x, y = case.rocks["x_m"].to_numpy(), case.rocks["y_m"].to_numpy()
    cells = grid.cell_of(x, y)
    assert (cells >= 0).all()
    assert np.isfinite(grid.values.ravel()[cells]).all()
    whole = case.footprint.loc[case.footprint["level"] == 0.0].geometry.iloc[0]
    # Rocks that never start come to no cell. The buffer is for points on the border of cells.
    never = (case.rocks["reason"] == "never_started").to_numpy()
    assert shapely.intersects_xy(whole.buffer(1e-3), x, y)[~never].all()
    with rasterio.open(case.result.folder / "maps" / "stops.tif") as source:
        counted = source.read(1, masked=True)
    stopped = case.rocks["reason"].isin(["rest", "barrier"])
    assert counted.sum() == (stopped & ~never).sum()
