"""Whole zonings become files that ilivalidator accepts against the text of the federal model."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import geopandas as gpd
import pyproj
import pytest
import rasterio

from sassgis.outputs.swiss.transfer import ExportResult, export_xtf
from sassgis.runs.run import zone

#: From the Austrian coordinates of the Tyrolean terrain into those of Switzerland (m).
MOVED = (2_500_000.0, 800_000.0)
TIROL = """
[terrain]
dem = "dem.tif"
[release]
file = "release.gpkg"
spacing_m = 40.0
rocks_per_point = 2
[ground]
default = "debris"
[hazard]
ref_width_m = 10.0
canton = "GR"
[[blocks]]
name = "1 m3"
axis_1_m = [0.65, 0.85]
axis_2_m = [0.55, 0.70]
axis_3_m = [0.45, 0.60]
onset_frequency = 0.3
"""


def exported(config: Path, folder: Path, models: Path, canton: str | None) -> ExportResult:
    zone(config, folder / "out", jobs=1)
    return export_xtf(folder / "out", folder / "zones.xtf", models, canton=canton)


def refused(found: ExportResult) -> str:
    return "\n".join(found.lines())


@pytest.mark.battery
def test_the_zoning_of_the_demo_is_accepted(
    make_valley: Callable[..., Path], tmp_path: Path, official_models: Path
) -> None:
    found = exported(make_valley(), tmp_path, official_models, "TI")
    assert found.accepted, refused(found)
    assert all(count > 0 for count in found.objects.values()), found.objects
    indicated, levels = (
        gpd.read_file(tmp_path / "out" / "hazard.gpkg", layer=name)
        for name in ("indicative_hazard_area", "hazard_area")
    )
    assert indicated["hazard_area_existing"].all() and indicated["hazard_indication"].all()
    assert indicated.union_all().difference(levels.union_all()).area == pytest.approx(0.0, abs=1e-3)


@pytest.mark.battery
def test_a_zoning_of_the_size_of_a_valley_in_tyrol_is_accepted(
    shared_data: Path, tmp_path: Path, official_models: Path
) -> None:
    """567 x 787 cells of 5 m, 40 % of them unknown; moved, as the model takes LV95 only."""
    place = shared_data / "tirol_avaMalRegional"
    if not place.is_dir():
        pytest.skip("tirol_avaMalRegional is not in the folder of the field data")
    with rasterio.open(place / "avaMal.tif") as source:
        heights, profile = source.read(), source.profile
    west, north, cell = (profile["transform"][k] for k in (2, 5, 0))
    moved = rasterio.transform.from_origin(west + MOVED[0], north + MOVED[1], cell, cell)
    with rasterio.open(
        tmp_path / "dem.tif", "w", **{**profile, "transform": moved, "crs": "EPSG:2056"}
    ) as target:
        target.write(heights)
    release = gpd.read_file(place / "REL" / "relMalRegional.shp")[["geometry"]]
    release["name"] = [f"area {number}" for number in range(len(release))]
    release.geometry = release.geometry.translate(*MOVED)
    release.set_crs(pyproj.CRS(2056), allow_override=True).to_file(tmp_path / "release.gpkg")
    (tmp_path / "config.toml").write_text(TIROL)
    found = exported(tmp_path / "config.toml", tmp_path, official_models, None)
    assert found.accepted, refused(found)
    assert min(found.objects.values()) > 0
    assert found.objects["intensity_by_source"] > 100
