from __future__ import annotations

import json
import logging
import math
from dataclasses import replace
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import pytest
from helpers.input_files import MAP_RUN, NORTH, WEST, at
from helpers.one_line import one_line
from helpers.sections import section_of
from shapely import (
    GeometryCollection,
    LineString,
    MultiLineString,
    MultiPoint,
    MultiPolygon,
    Point,
    Polygon,
    box,
)

from sassgis.errors import ConfigError, InputError
from sassgis.grid import Grid
from sassgis.inputs.config import load_config
from sassgis.inputs.vector_features import Feature, cells_under, steepest_slope_deg
from sassgis.inputs.vectors import START_SLOPE_DEG, read_control_lines, read_release
from sassgis.settings.results import ControlLine
from sassgis.settings.settings import ReleaseSettings

BLOCKS = ("large", "small")


def settings(path, **keys):
    return section_of(ReleaseSettings, {"file": path, **keys}, Path("config.toml"))


AREA = at(52, 31, 97, 58)


@pytest.mark.parametrize(
    ("name", "to"),
    [("a.gpkg", None), ("a.shp", None), ("a.geojson", "EPSG:4326"), ("a.gpkg", "EPSG:21781")],
)
def test_one_area_in_several_formats_and_systems(make_layer, slope_grid, caplog, name, to):
    path = make_layer([AREA], name, to=to, number=[3.0])
    with caplog.at_level(logging.INFO, "sassgis"):
        (area,) = read_release(settings(path, name_field="number"), slope_grid, BLOCKS)
    # Numbers serve as names.
    assert area.name == "3" and area.scenarios == BLOCKS
    # GeoJSON keeps 7 decimals of a degree: about a centimetre.
    assert area.geometry.symmetric_difference(AREA).area < 1.5
    assert ("reprojected" in caplog.text) == (to is not None)


def test_lines_points_and_collections_of_parts(make_layer, slope_grid):
    x0, y0, x1, y1 = AREA.bounds
    shapes = [
        LineString([(WEST + 20, NORTH - 20), (WEST + 80, NORTH - 25)]),
        Point(WEST + 33, NORTH - 44),
        MultiPolygon([at(10, 60, 30, 80), at(40, 60, 60, 80)]),
        MultiPoint([(WEST + 100, NORTH - 50), (WEST + 120, NORTH - 50)]),
        Polygon([(x0, y0, 5.0), (x1, y0, 5.0), (x1, y1, 7.0)]),
    ]
    areas = read_release(settings(make_layer(shapes, "r.geojson", to=None)), slope_grid, BLOCKS)
    assert [a.name for a in areas] == [f"area {k}" for k in range(1, 6)]
    assert [a.geometry.geom_type for a in areas] == [s.geom_type for s in shapes]
    assert areas[2].geometry.area == pytest.approx(800.0, rel=1e-3)
    assert not areas[4].geometry.has_z


def test_scenarios_come_from_the_attribute(make_layer, slope_grid, caplog):
    shapes = [at(10 + 40 * i, 31, 40 + 40 * i, 58) for i in range(4)]
    path = make_layer(shapes, blocks=["small", "small; large", None, "large,large"])
    with caplog.at_level(logging.INFO, "sassgis"):
        areas = read_release(settings(path, scenario_field="blocks"), slope_grid, BLOCKS)
    found = [("small",), ("small", "large"), ("large", "small"), ("large",)]
    assert [a.scenarios for a in areas] == found
    assert "feature 3 names no scenario" in caplog.text


def test_what_pandas_has_for_nothing_is_empty():
    row = {"a": pd.NA, "b": None, "c": math.nan, "d": 7.0, "e": pd.NaT}
    feature = Feature(2, row, None, "", Path("a.gpkg"), "a")
    assert [feature.text(name) for name in row] == [None, None, None, "7", None]
    assert feature.label == "feature 2"
    with one_line(InputError, "a.gpkg: a: feature 2: is not a number", "<NA>"):
        feature.value("a")


def test_without_a_system_that_of_the_dem_is_taken_if_it_fits(make_layer, slope_grid, caplog):
    path = make_layer([AREA], "release.shp", crs=None)
    with caplog.at_level(logging.INFO, "sassgis"):
        (area,) = read_release(settings(path), slope_grid, BLOCKS)
    assert area.geometry.equals(AREA)
    assert "taken to be that of the DEM" in caplog.text


def test_local_dem_takes_local_vectors_only(make_layer, slope_grid):
    local = replace(slope_grid, west=0.0, north=200.0, crs="")
    here = box(50.0, 100.0, 90.0, 130.0)
    for name in ("local.shp", "local.geojson"):  # GeoJSON is always read as WGS 84
        path = make_layer([here], name, crs=None)
        assert read_release(settings(path), local, BLOCKS)[0].geometry.equals(here)
    with one_line(InputError, "release.gpkg", "release.file", "local coordinates", "LV95"):
        read_release(settings(make_layer([AREA])), local, BLOCKS)


@pytest.fixture
def refused(slope_grid):
    def check(path, *words, grid: Grid | None = None, **keys):
        with one_line(InputError, Path(path).name, *words):
            read_release(settings(path, **keys), grid or slope_grid, BLOCKS)

    return check


def test_missing_layer_lists_the_layers(refused, make_layer, slope_grid):
    path = make_layer([AREA], layer="north")
    make_layer([at(10, 60, 30, 80)], layer="south")
    (area,) = read_release(settings(path, layer="south"), slope_grid, BLOCKS)
    assert area.geometry.equals(at(10, 60, 30, 80))
    refused(path, "release.layer", "'nort'", "north, south", "nearest: north", layer="nort")
    refused(path, "release.layer", "several layers", "north, south")
    table = gpd.GeoDataFrame({"a": [1]}, geometry=[Point(0, 0)]).drop(columns="geometry")
    pyogrio.write_dataframe(table, path.with_name("table.gpkg"), layer="numbers")
    none = path.with_name("table.gpkg")
    refused(none, "release.file", "no layer with geometry", "numbers")
    empty = make_layer([], "empty.gpkg", layer="none")
    refused(empty, "release.file", "no feature", "layer none", "empty", "at least one")


def test_missing_fields_and_unknown_scenarios(refused, make_layer):
    path = make_layer([AREA], title=["a"], rock=["small;lrge"])
    words = ["release.name_field", "'titel'", "title, rock", "nearest: title"]
    refused(path, *words, name_field="titel")
    refused(path, "release.scenario_field", "'x'", "one of title, rock", scenario_field="x")
    words = ["rock", "feature 1 (a)", "'lrge'", "one of large, small (nearest: large)"]
    refused(path, *words, scenario_field="rock", name_field="title")


X0, Y0, X1, Y1 = AREA.bounds
BOW = Polygon([(X0, Y0), (X1, Y1), (X1, Y0), (X0, Y1)])
FAR = at(1000, 31, 1100, 58)
SWISS = gpd.GeoSeries([AREA], crs=2056).to_crs(4326).total_bounds
SWAPPED = box(SWISS[1], SWISS[0], SWISS[3], SWISS[2])
#: Shapes, how they are written, and words of the message.
SHAPES = {
    "none": ([AREA, None], {}, ["feature 2 (b)", "no usable geometry", "polygon"]),
    "crossing": ([AREA, BOW], {}, ["feature 2 (b)", "Self-intersection",
                 f"[{0.5 * (X0 + X1)} {0.5 * (Y0 + Y1)}]"]),
    "collection": ([GeometryCollection([AREA, Point(WEST + 5, NORTH - 5)])], {},
                   ["feature 1", "wrong kind", "GeometryCollection", "polygon or line or point"]),
    "outside": ([AREA, FAR], {}, ["feature 2 (b)", "outside the DEM", "2701000", "within x 27"]),
    # Cells under such a polygon would be looked for without end.
    "no place": ([Polygon([(X0, Y0), (X1, Y0), (X1, Y0 - 1e308)])], {},
                 ["feature 1", "coordinate that is no place on Earth"]),
    "no system": ([box(8.9, 46.4, 8.91, 46.41)], {"crs": None, "name": "release.shp"},
                  ["no coordinate system", "8.9", "coordinates of the DEM: x 2700000"]),
    "swapped": ([SWAPPED], {"crs": "EPSG:4326"},
                ["latitude and longitude are swapped", "longitude first"]),
    "another system": ([AREA], {"crs": "EPSG:21781"},
                       ["only if it is not reprojected", "CH1903 / LV03", "CH1903+ / LV95"]),
}  # fmt: skip


@pytest.mark.parametrize("case", SHAPES)
def test_shapes_that_cannot_be_used(refused, make_layer, case):
    shapes, written, words = SHAPES[case]
    path = make_layer(shapes, **written, title=["a", "b"][: len(shapes)])
    refused(path, *words, name_field="title")


def test_metres_tagged_as_degrees(refused, tmp_path):
    path = tmp_path / "release.geojson"
    shape = {"type": "Polygon", "coordinates": [list(map(list, AREA.exterior.coords))]}
    path.write_text(json.dumps({"type": "Feature", "properties": {}, "geometry": shape}))
    refused(path, "release.file", "cannot be degrees", "WGS 84", "tagged")


def test_names_are_identities(refused, make_layer):
    path = make_layer([AREA, at(152, 31, 197, 58)], title=["a", "a"])
    refused(path, "title", "used twice", "'a' in features 1 and 2", name_field="title")
    path = make_layer([AREA, at(152, 31, 197, 58)], "b.gpkg", title=["a", None])
    refused(path, "title", "feature 2 has no name", name_field="title")


@pytest.mark.parametrize(
    ("shape", "known", "says"),
    [
        # Cells of 10 m; heights are missing west of 60 m.
        (at(53, 31, 83, 58), 23 / 30, "23.3 % of it is nodata; no block starts there"),
        (at(-20, 31, 80, 58), 20 / 100, "feature 1: 20.0 % of it lies outside the DEM"),
        (LineString([(WEST + 30, NORTH - 35), (WEST + 130, NORTH - 35)]), 70 / 100, "30.0 %"),
        # Along the border of two rows, and across, with a third outside.
        (LineString([(WEST + 30, NORTH - 40), (WEST + 130, NORTH - 40)]), 70 / 100, "30.0 %"),
        (LineString([(WEST + 100, NORTH + 20), (WEST + 100, NORTH - 40)]), 4 / 6, "33.3 %"),
        (MultiPoint([(WEST + x, NORTH - 35) for x in (50, 70, 80)]), 2 / 3, "33.3 %"),
    ],
)
def test_the_share_on_known_terrain_is_that_of_the_shape(
    make_layer, slope_grid, caplog, shape, known, says
):
    values = slope_grid.values.copy()
    values[:, :6] = np.nan
    grid = replace(slope_grid, values=values)
    (area,) = read_release(settings(make_layer([shape])), grid, BLOCKS)
    assert area.known == pytest.approx(known, abs=1e-8)
    assert says in caplog.text and "as many if it is per year" in caplog.text
    # A part of the terrain that holds the shape gives the same bits.
    part = grid.part(slice(0, 8), slice(0, 20))
    (again,) = read_release(settings(make_layer([shape], "again.gpkg")), part, BLOCKS)
    assert again.known == area.known
    with one_line(InputError, "feature 1", "lies on nodata", "no height"):
        read_release(settings(make_layer([at(3, 31, 50, 58)], "none.gpkg")), grid, BLOCKS)


@pytest.mark.parametrize(("degrees", "warned"), [(19.5, True), (21.0, False)])
def test_areas_too_flat_to_start_from_are_warned_of(
    make_layer, slope_grid, caplog, degrees, warned
):
    values = (slope_grid.values - 1000.0) * math.tan(math.radians(degrees)) + 1000.0
    read_release(settings(make_layer([AREA])), replace(slope_grid, values=values), BLOCKS)
    text = f"nowhere steeper than {degrees:.1f} degrees"
    assert (text in caplog.text) is warned
    assert pytest.approx(20.3, abs=0.02) == START_SLOPE_DEG


def test_overlaps_are_warned_of_within_a_scenario(make_layer, slope_grid, caplog):
    shapes = [at(10, 30, 50, 60), at(30, 30, 80, 60), at(200, 30, 220, 60)]
    path = make_layer(shapes, blocks=["small", "large", "large"])
    read_release(settings(path, scenario_field="blocks"), slope_grid, BLOCKS)
    assert not caplog.records
    read_release(settings(path), slope_grid, BLOCKS)
    assert [r.getMessage().split(": ")[1] for r in caplog.records] == [
        "areas area 1 and area 2 overlap by 600.0 m2; blocks start there from both"
    ]


def test_open_rings_are_refused_and_the_reason_is_told(refused, tmp_path, caplog):
    ring = [list(p) for p in gpd.GeoSeries([AREA], crs=2056).to_crs(4326)[0].exterior.coords[:-1]]
    shape = {"type": "Polygon", "coordinates": [ring]}
    path = tmp_path / "open.geojson"
    path.write_text(json.dumps({"type": "Feature", "properties": {}, "geometry": shape}))
    refused(path, "release.file", "feature 1 has no usable geometry")
    assert "Non closed ring" in caplog.text


def test_cells_under_polygons_lines_and_points(slope_grid):
    def marked(shape):
        rows, cols, mask = cells_under(shape, slope_grid)
        full = np.zeros(slope_grid.shape, bool)
        full[rows, cols] = mask
        return sorted(zip(*map(list, np.nonzero(full)), strict=True))

    assert marked(at(50, 30, 70, 40)) == [(3, 5), (3, 6)]
    assert marked(at(54, 30, 70, 40)) == [(3, 5), (3, 6)]
    assert marked(at(56, 30, 70, 40)) == [(3, 6)]  # the centre of column 5 is outside
    assert marked(at(51, 31, 53, 33)) == [(3, 5)]  # holds no centre
    assert marked(Point(WEST + 299.0, NORTH - 199.0)) == [(19, 29)]
    line = LineString([(WEST + 1, NORTH - 5), (WEST + 25, NORTH - 5)])
    assert marked(line) == [(0, 0), (0, 1), (0, 2)]


def test_steepest_slope_is_that_of_the_plane_even_at_the_edge(slope_grid):
    for shape in (AREA, at(0, 0, 10, 10), at(290, 190, 300, 200), Point(WEST + 5, NORTH - 5)):
        assert steepest_slope_deg(shape, slope_grid) == pytest.approx(45.0)


@pytest.fixture
def control_lines(tmp_path, slope_grid):
    def read(text):
        path = tmp_path / "run.toml"
        path.write_text(MAP_RUN + text)
        return read_control_lines(load_config(path), slope_grid)

    return read


ROAD = LineString([(WEST + 10, NORTH - 150), (WEST + 100, NORTH - 150), (WEST + 290, NORTH - 155)])


def test_control_lines_from_lines_and_files(make_layer, control_lines):
    first, middle, last = ROAD.coords
    parts = MultiLineString([[first, middle], [middle, last]])
    make_layer([parts, ROAD.parallel_offset(20)], "s.gpkg", name=["road", "rail"])
    result = control_lines(f"""
[[stations]]
name = "s"
file = "s.gpkg"
name_field = "name"
[[barriers]]
name = "net"
kind = "net"
height_m = 4
capacity_kj = 2000
line = [[{WEST + 10}, {NORTH - 90}], [{WEST + 10}, {NORTH - 90}], [{WEST + 200}, {NORTH - 95}]]
[[barriers]]
name = "wall"
kind = "wall"
height_m = 3
file = "s.gpkg"
""")
    assert [(g.name, g.kind, g.height_m, g.capacity_kj) for g, _ in result] == [
        ("road", "station", 0.0, math.inf),
        ("rail", "station", 0.0, math.inf),
        ("net", "net", 4.0, 2000.0),
        ("wall 1", "wall", 3.0, math.inf),
        ("wall 2", "wall", 3.0, math.inf),
    ]
    # Parts that meet are one line.
    np.testing.assert_array_equal(result[0][1], np.array(ROAD.coords))
    np.testing.assert_array_equal(result[2][1], [[WEST + 10, NORTH - 90], [WEST + 200, NORTH - 95]])
    assert result[2][1].dtype == np.float64


BARRIERS = """
[[barriers]]
name = "b"
file = "b.gpkg"
kind_field = "kind"
height_m_field = "height_m"
width_m_field = "width_m"
cushion_kpa_field = "cushion_kpa"
"""


def test_a_gallery_and_a_wall_of_one_layer(make_layer, control_lines):
    columns = {"kind": ["gallery", "wall"], "height_m": [0.0, 3.0]}
    empty = {"width_m": [8.0, None], "cushion_kpa": [3200.0, None]}
    lines = [ROAD, ROAD.parallel_offset(20)]
    make_layer(lines, "b.gpkg", **columns, **empty)
    (gallery, _), (wall, _) = control_lines(BARRIERS)
    assert gallery == ControlLine(
        "b 1", "gallery", width_m=8.0, roof_slope_deg=0.0, cushion_kpa=3200.0
    )
    assert wall == ControlLine("b 2", "wall", 3.0)
    make_layer(lines, "b.gpkg", **columns, **empty | {"width_m": [None, None]})
    with one_line(InputError, "feature 1", "width_m", "has no value"):
        control_lines(BARRIERS)
    make_layer(lines, "b.gpkg", **columns, **empty | {"width_m": [8.0, 8.0]})
    with one_line(InputError, "feature 2", "width_m", "does not go with a wall"):
        control_lines(BARRIERS)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("line = [[0, 0], [10, 10]]", ["stations[road].line", "outside the DEM", "x 0 to 10"]),
        ("line = [[2700010, 1149900], [2700010, 1149900]]",
         ["stations[road].line", "no length", "two points that differ"]),
        ("chainage_m = 3", ["stations[road]", "chainage_m", "line or file"]),
        ('file = "parts.gpkg"', ["parts.gpkg", "feature 1", "2 parts", "one line"]),
        ('file = "area.gpkg"', ["stations[road].file", "feature 1", "Polygon", "a line"]),
    ],
)  # fmt: skip
def test_stations_that_cannot_be_used(make_layer, control_lines, text, words):
    make_layer([MultiLineString([ROAD, ROAD.parallel_offset(20)])], "parts.gpkg")
    make_layer([AREA], "area.gpkg")
    with one_line(InputError, *words):
        control_lines(f'[[stations]]\nname = "road"\n{text}')


def test_names_differ_over_files_too(make_layer, control_lines, caplog):
    make_layer([ROAD], "s.gpkg", title=["road"])
    line = f"line = [[{WEST + 200}, {NORTH - 9}], [{WEST + 400}, {NORTH - 9}]]"
    own = f'[[stations]]\nname = "road"\n{line}\n'
    second = '[[stations]]\nname = "rail"\nfile = "s.gpkg"\n'
    # A single feature takes the name of the station.
    assert [station.name for station, _ in control_lines(own + second)] == ["road", "rail"]
    assert "stations[road].line: road: 50.0 % of it lies outside the DEM" in caplog.text
    with one_line(ConfigError, "run.toml", "used twice", "'road'"):
        control_lines(own + second + 'name_field = "title"')
