"""A site is drawn in the real QGIS, and the configuration made from it reads every layer."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from helpers.in_qgis import in_qgis
from helpers.small_slope import CELL, COLS, NORTH, ROWS, WEST, Slope, heights

from sassgis.inputs.config import load_config
from sassgis.inputs.ground_map import built_in_table
from sassgis.inputs.site_layers import site_layers, start_keys
from sassgis.outputs.config_template import short_template
from sassgis.outputs.site_template import site_template
from sassgis.runs.check_inputs import check_inputs

PROBE = Path(__file__).with_name("site_probe.py")


def box(col: float, row: float, size: float) -> str:
    west, north = WEST + CELL * col, NORTH - CELL * row
    east, south = west + CELL * size, north - CELL * size
    ring = f"{west} {north},{east} {north},{east} {south},{west} {south},{west} {north}"
    return f"MultiPolygon ((({ring})))"


def line(col: float) -> str:
    x = WEST + CELL * col
    return f"LineString ({x} {NORTH - CELL}, {x} {NORTH - CELL * (ROWS - 1)})"


FEATURES: dict[str, dict[str, Any]] = {
    "stations": {"wkt": line(30), "attributes": {"name": "road"}},
    "barriers": {
        "wkt": line(40),
        "attributes": {"name": "N", "kind": "net", "height_m": 3.5, "capacity_kj": 500.0},
    },
    "release_areas": {"wkt": box(3, 15, 5), "attributes": {"name": "north"}},
    "forest": {"wkt": box(10, 10, 20), "attributes": {"stems_per_ha": 400.0, "dbh_cm": 30.0}},
    "ground": {"wkt": box(0, 0, COLS), "attributes": {"class": "talus"}},
    "buildings": {
        "wkt": box(60, 10, 4),
        "attributes": {"name": "house", "value": 8e5, "persons": 2.0, "presence": 0.6},
    },
    "roads": {
        "wkt": line(55),
        "attributes": {
            "name": "main", "traffic_per_day": 800.0, "speed_kmh": 50.0,
            "vehicle_length_m": 5.0, "persons_per_vehicle": 1.6,
        },
    },
}  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site ü")
    Slope(folder).write_dem(heights())
    site_template(folder / "site.gpkg", dem=folder / "dem.tif")
    return folder


@pytest.fixture(scope="module")
def drawn(qgis: None, folder: Path) -> dict[str, Any]:
    (folder / "features.json").write_text(json.dumps(FEATURES))
    out = in_qgis(PROBE, folder / "site.qgz", folder / "features.json", home=folder)
    return json.loads(out)  # type: ignore[no-any-return]


@pytest.mark.qgis
def test_every_layer_is_valid_and_over_the_terrain(drawn: dict[str, Any]) -> None:
    assert drawn["opened"] and drawn["crs"] == "EPSG:2056"
    assert set(drawn["layers"]) == {own.name for own in site_layers()} | {"Relief"}
    for name, layer in drawn["layers"].items():
        assert layer["valid"] and layer["crs"] == "EPSG:2056", name
        assert name not in FEATURES or layer["saved"], layer


@pytest.mark.qgis
def test_the_forms_offer_what_may_be_entered(drawn: dict[str, Any]) -> None:
    classes = drawn["layers"]["ground"]["form"]["class"]
    assert classes["widget"] == "ValueMap"
    offered = [next(iter(entry)) for entry in classes["config"]["map"]]
    assert offered == list(built_in_table().names)
    barriers = drawn["layers"]["barriers"]["form"]
    assert [next(iter(e)) for e in barriers["kind"]["config"]["map"]] == ["wall", "net", "gallery"]
    assert barriers["height_m"]["widget"] == "Range"
    assert [barriers["height_m"]["config"][k] for k in ("Min", "Max")] == [0.0, 100.0]
    assert barriers["height_m"]["alias"] == "height (m)"
    # Not empty: 1; unique: 2.
    assert [barriers[k]["constraints"] for k in ("name", "kind", "capacity_kj")] == [3, 1, 0]
    assert drawn["choices"] in (None, ["gallery", "net", "wall"])


@pytest.mark.qgis
def test_the_configuration_made_from_it_reads_every_layer(
    drawn: dict[str, Any], folder: Path
) -> None:
    config = folder / "sassgis.toml"
    given = start_keys(folder, folder / "dem.tif", folder / "site.gpkg")
    config.write_text(short_template(given))
    settings = load_config(config)
    report = check_inputs(settings)
    assert [a["name"] for a in report.areas] == ["north"]
    assert [(c.name, c.kind) for c in report.control_lines] == [("road", "station"), ("N", "net")]
    assert (report.control_lines[1].height_m, report.control_lines[1].capacity_kj) == (3.5, 500.0)
    assert [c["name"] for c in report.classes] == ["talus"]
    assert settings.trees is not None and settings.trees.dbh_field == "dbh_cm"
    assert {o.kind: set(o.fields) for o in settings.objects} == {
        "building": {"value", "persons", "presence"},
        "road": {"traffic_per_day", "speed_kmh", "vehicle_length_m", "persons_per_vehicle"},
    }
