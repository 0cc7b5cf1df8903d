"""Zones and paths for other viewers: GeoJSON and KML."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree as ET

import geopandas as gpd
import numpy as np
import pyogrio
import pytest
import shapely

from sassgis.errors import InputError, OutputError
from sassgis.files.atomic_output import WRITTEN_NAME
from sassgis.files.vector_layer import VectorLayer
from sassgis.grid import Grid
from sassgis.outputs.geopackage import write_geopackage
from sassgis.outputs.raster import write_raster
from sassgis.outputs.view_files import export_view
from sassgis.settings.results import Band, RasterClass, RasterLayer
from sassgis.settings.styles import Symbol, VectorStyle

CRS = "EPSG:2056"
KML = "{http://www.opengis.net/kml/2.2}"
WEST, NORTH = 2_700_000.0, 1_120_000.0
LEVELS = (RasterClass(1, "low (yellow)", "#ffe34d"), RasterClass(2, "high (red)", "#d7262b"))
PATH = [(WEST, NORTH, 500.0), (WEST + 30.0, NORTH, 480.5), (WEST + 60.0, NORTH, 450.0)]


def a_result(folder: Path, crs: str | None = CRS, area: str = "Nord & <Süd>") -> Path:
    """A folder with two zones and a path."""
    folder.mkdir()
    (folder / "manifest.json").write_text("{}")
    zones = gpd.GeoDataFrame(
        {"zone": [1, 2], "hazard_level": ["slight", "substantial"],
         "label": [c.label for c in LEVELS], "area_m2": [100.0] * 2, "governing_area": [area] * 2},
        geometry=[shapely.box(WEST + d, NORTH, WEST + d + 10.0, NORTH + 10.0) for d in (0, 10)],
        crs=crs,
    )  # fmt: skip
    paths = gpd.GeoDataFrame(
        {"area": [area], "scenario": ["big"], "max_energy_kj": [12.345678]},
        geometry=[shapely.LineString(PATH)], crs=crs,
    )  # fmt: skip
    fill, line = VectorStyle(Symbol("fill", "#808080")), VectorStyle(Symbol("line", "#808080"))
    write_geopackage(
        folder / "hazard.gpkg", [VectorLayer("hazard_zones", "", "", zones, style=fill)]
    )
    write_geopackage(folder / "result.gpkg", [VectorLayer("paths", "", "", paths, style=line)])
    values = np.ones((2, 2), np.float32)
    level = RasterLayer("hazard_level", "", "", (Band("level", "", "", values),), (), "", LEVELS)
    write_raster(level, Grid(values.astype(float), WEST, NORTH, 2.0), folder / "maps")
    return folder


def test_zones_as_geojson(tmp_path: Path) -> None:
    file = tmp_path / "z.geojson"
    said = export_view(a_result(tmp_path / "r"), file, "zones")
    assert "2 hazard zones" in said
    content = json.loads(file.read_text(encoding="utf-8"))
    # RFC 7946: no "crs", longitude before latitude, outer rings against the clock.
    assert "crs" not in content
    for feature, level in zip(content["features"], LEVELS, strict=True):
        assert feature["properties"]["fill"] == level.colour
        shape = shapely.geometry.shape(feature["geometry"])
        assert 8.0 < shape.centroid.x < 9.0 and 46.0 < shape.centroid.y < 47.0
        assert all(p.exterior.is_ccw for p in shapely.get_parts(shape))
    back = gpd.read_file(file).to_crs(CRS)
    assert back.area.to_numpy() == pytest.approx([100.0, 100.0], rel=5e-3)
    assert back["governing_area"][0] == "Nord & <Süd>"


def test_zones_as_kml(tmp_path: Path) -> None:
    file, again, result = tmp_path / "z.kml", tmp_path / "again.kml", a_result(tmp_path / "r")
    for target in (file, again):
        export_view(result, target, "zones")
    assert file.read_bytes() == again.read_bytes()
    marks = list(ET.parse(file).iter(f"{KML}Placemark"))
    assert [m.findtext(f"{KML}name") for m in marks] == [c.label for c in LEVELS]
    # KML writes alpha, blue, green, red.
    colours = [m.findtext(f".//{KML}PolyStyle/{KML}color") for m in marks]
    assert colours == ["b24de3ff", "b22b26d7"]
    data = {d.get("name"): d.text for d in marks[0].iter(f"{KML}SimpleData")}
    assert data == {
        "zone": "1", "hazard level": "slight", "label": "low (yellow)", "area (m²)": "100",
        "governing area": "Nord & <Süd>",
    }  # fmt: skip
    assert len(pyogrio.read_dataframe(file)) == 2


def test_paths_keep_their_heights(tmp_path: Path) -> None:
    result = a_result(tmp_path / "r")
    for name in ("p.geojson", "p.kml"):
        export_view(result, tmp_path / name, "paths")
        back = pyogrio.read_dataframe(tmp_path / name).to_crs(CRS)
        found = shapely.get_coordinates(back.geometry.to_numpy(), include_z=True)
        assert np.abs(found - PATH).max() < 0.02, name
    text = (tmp_path / "p.kml").read_text(encoding="utf-8")
    assert "<altitudeMode>absolute</altitudeMode>" in text and "OGR_STYLE" not in text
    assert "12.3457" in text and 'name="max energy (kJ)"' in text


def test_what_cannot_be_exported(tmp_path: Path) -> None:
    result = a_result(tmp_path / "r")
    with pytest.raises(InputError, match=r"unknown format \(found z.shp; expected.*\.kml"):
        export_view(result, tmp_path / "z.shp", "zones")
    with pytest.raises(InputError, match="not a result"):
        export_view(tmp_path / "none", tmp_path / "z.kml", "zones")
    local = a_result(tmp_path / "local", crs=None)
    with pytest.raises(InputError, match="KML needs coordinates on the Earth"):
        export_view(local, tmp_path / "z.kml", "zones")
    (result / "hazard.gpkg").unlink()
    with pytest.raises(InputError, match="no hazard zones"):
        export_view(result, tmp_path / "z.kml", "zones")
    export_view(result, tmp_path / "p.kml", "paths")
    with pytest.raises(OutputError, match="exists already"):
        export_view(result, tmp_path / "p.kml", "paths")
    export_view(result, tmp_path / "p.kml", "paths", overwrite=True)
    assert not list(tmp_path.glob("z*"))
    assert [p.name for p in tmp_path.glob(".*")] == [WRITTEN_NAME]
