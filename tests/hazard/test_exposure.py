"""Reading exposed objects: stretches, cells, and what is refused in which words."""

from __future__ import annotations

import itertools
import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from helpers.exposed_objects import read_objects
from helpers.one_line import one_line
from helpers.worked_example import HOUSE, ROAD, vulnerability
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import LineString, MultiLineString, MultiPoint, Point, box
from shapely.affinity import rotate, translate

from sassgis.errors import InputError
from sassgis.grid import Grid
from sassgis.inputs.objects import chainage, joined_objects, object_cells, read_vulnerability
from sassgis.settings.exposure import PlacedObjects, Traffic, Vulnerability

TRAFFIC = {
    "traffic_per_day": 2000.0, "speed_kmh": 50.0, "vehicle_length_m": 5.0,
    "persons_per_vehicle": 1.5,
}  # fmt: skip
BEND = LineString([(20, 40), (150, 55), (170, 130), (340, 160)])
CODES = ("low", "mean", "high")


TWO_HOUSES = [box(20, 20, 32, 30), box(50, 20, 62, 30)]


# --- what is read -----------------------------------------------------------------------------


def test_buildings_with_their_numbers(layer, grid):
    path = layer(TWO_HOUSES, house=["A", "B"], chf=[500_000, 800_000], people=[3.0, 12.0])
    placed = read_objects(
        path, grid, kind="building", name="houses", name_field="house",
        fields={"value": "chf", "persons": "people"}, defaults={"presence": 0.6},
    )  # fmt: skip
    a, b = placed.objects
    assert (a.name, a.kind, a.value, a.persons, a.presence) == ("A", "building", 5e5, 3.0, 0.6)
    assert (b.name, b.value, b.persons) == ("B", 8e5, 12.0)
    assert placed.geometries[0].area == pytest.approx(120.0)


def test_an_empty_attribute_takes_the_default(layer, grid):
    path = layer(TWO_HOUSES, chf=[500_000.0, None])
    placed = read_objects(
        path, grid, kind="building", fields={"value": "chf"}, defaults={"value": 1.0}
    )
    assert [o.value for o in placed.objects] == [5e5, 1.0]
    assert [o.name for o in placed.objects] == ["objects 1", "objects 2"]


def test_objects_in_another_system_are_reprojected(layer, grid):
    shape = box(20, 20, 60, 50)
    here = read_objects(layer([shape]), grid, kind="building", name="a")
    there = read_objects(layer([shape], "b.gpkg", to="EPSG:21781"), grid, kind="building", name="a")
    assert shapely.hausdorff_distance(here.geometries[0], there.geometries[0]) < 0.5
    assert there.geometries[0].centroid.x == pytest.approx(2_700_040.0, abs=0.5)


def test_people_stand_on_their_cell_or_around(layer, grid):
    path = layer([Point(101, 81), MultiPoint([(11, 11), (15, 11)])], who=["school", "two huts"])
    options = {"kind": "people", "name_field": "who", "defaults": {"persons": 30.0}}
    placed = read_objects(path, grid, **options)
    cells, owner = object_cells(placed, grid)
    assert np.bincount(owner).tolist() == [1, 2]
    assert cells[owner == 0].tolist() == [40 * 200 + 50]
    around = read_objects(path, grid, **options, radius_m=10.0)
    cells, owner = object_cells(around, grid)
    area = np.bincount(owner)[0] * grid.cell_size**2
    # A disc of 10 m, and up to a cell on each side.
    assert np.pi * 10.0**2 < area < np.pi * 13.0**2


# --- stretches --------------------------------------------------------------------------------


@given(
    st.lists(st.tuples(st.floats(5, 395), st.floats(5, 235)), min_size=2, max_size=8, unique=True),
    st.floats(6.0, 120.0),
)
@settings(max_examples=30)
def test_stretches_add_up_to_the_road(points, segment_m):
    from sassgis.inputs.objects import _stretches

    line = LineString(points)
    if line.length < 1.0:
        return
    grid = Grid(np.zeros((120, 200)), 0.0, 240.0, 2.0)
    parts = _stretches(replace(ROAD, name="road", parent=""), line, segment_m, grid, Path("x"))
    lengths = [thing.length_m for thing, _ in parts]
    assert sum(lengths) == pytest.approx(line.length, rel=1e-12)
    assert [shape.length for _, shape in parts] == pytest.approx(lengths, rel=1e-9, abs=1e-9)
    assert max(lengths) - min(lengths) < 1e-6
    assert len(parts) == max(1, round(line.length / segment_m))
    ends = [thing.from_m + thing.length_m for thing, _ in parts]
    assert [thing.from_m for thing, _ in parts[1:]] == pytest.approx(ends[:-1])
    assert len({thing.name for thing, _ in parts}) == len(parts)


def test_more_stretches_than_a_road_can_have_are_refused_at_once(layer, grid):
    path = layer([LineString([(10, 50), (3e7, 50)])], nr=["Via"])
    with pytest.raises(InputError, match=r"too many stretches .*segment_m|segment_m: .*too many"):
        read_objects(path, grid, kind="line", defaults={"value_per_m": 1.0})


def test_stretches_have_names_by_chainage_and_the_numbers_of_the_road(layer, grid):
    path = layer([LineString([(10, 50), (210, 50)])], nr=["Via"], dtv=[3500])
    numbers = {**TRAFFIC, "traffic_per_day": None, "value_per_m": 3000.0}
    placed = read_objects(
        path, grid, kind="road", name="road", name_field="nr", fields={"traffic_per_day": "dtv"},
        defaults=numbers,
    )  # fmt: skip
    ends = ["0+000", "0+050", "0+100", "0+150", "0+200"]
    names = [f"Via {a}–{b}" for a, b in itertools.pairwise(ends)]
    assert [o.name for o in placed.objects] == names
    for thing in placed.objects:
        assert thing.parent == thing.whole == "Via"
        assert thing.traffic == Traffic(3500.0, 50.0, 5.0, 1.5)
        assert thing.value_per_m == 3000.0


@pytest.mark.parametrize(
    ("metres", "digits", "text"),
    [(0.0, 0, "0+000"), (999.6, 0, "1+000"), (12_345.678, 1, "12+345.7"), (50.5, 2, "0+050.50")],
)
def test_chainage_as_on_a_road(metres, digits, text):
    assert chainage(metres, digits) == text


def test_chainage_runs_on_over_a_tunnel(layer, grid):
    parts = MultiLineString([[(10, 50), (110, 50)], [(190, 50), (290, 50)]])
    placed = read_objects(layer([parts]), grid, kind="line", name="rail")
    assert [o.from_m for o in placed.objects] == pytest.approx([0.0, 50.0, 100.0, 150.0])
    assert sum(o.length_m for o in placed.objects) == pytest.approx(200.0)
    # Nothing stands in the gap.
    cells, _ = object_cells(placed, grid)
    x, _ = grid.cell_centres(cells)
    assert not ((x > 2_700_112.0) & (x < 2_700_188.0)).any()


def test_stretches_beyond_the_map_are_left_out_and_told(layer, grid, caplog):
    path = layer([LineString([(-120, 50), (180, 50)])])
    with caplog.at_level(logging.WARNING, "sassgis"):
        placed = read_objects(path, grid, kind="line", name="pipe", defaults={"value_per_m": 1.0})
    assert len(placed) == 4  # Of six stretches two lie beyond; half of one is on the map.
    assert placed.objects[0].from_m == pytest.approx(100.0)
    assert "40.0 % of it lies outside" in caplog.text
    assert "pipe: 2 of 6 stretches lie outside the DEM and are left out" in caplog.text


# --- cells ------------------------------------------------------------------------------------


def on_map(shape):
    return shapely.transform(shape, lambda p: p * [1.0, -1.0] + [2_700_000.0, 1_150_000.0])


def test_every_cell_of_a_road_is_that_of_one_stretch(layer, grid):
    whole = object_cells(PlacedObjects((replace(ROAD, parent=""),), (on_map(BEND),)), grid)[0]
    placed = read_objects(layer([BEND]), grid, kind="road", name="r", segment_m=17.0)
    cells, owner = object_cells(placed, grid)
    assert cells.tolist() == whole.tolist()
    assert np.bincount(owner, minlength=len(placed)).min() > 0
    # Of the stretches that touch it, the nearest to its centre has it.
    x, y = grid.cell_centres(cells)
    shapes = np.array(placed.geometries, object)
    far = shapely.distance(shapes[:, None], shapely.points(x, y)[None])
    boxes = shapely.box(x - 1.0, y - 1.0, x + 1.0, y + 1.0)
    within = shapely.length(shapely.intersection(shapes[:, None], boxes[None]))
    assert (within[owner, np.arange(cells.size)] > 0.0).all()
    far[within < 1e-6] = np.inf
    assert far[owner, np.arange(cells.size)] == pytest.approx(far.min(axis=0), abs=1e-9)


def test_cells_of_two_objects_are_those_of_both(grid):
    house = on_map(box(100, 50, 120, 60))
    placed = PlacedObjects(
        (HOUSE, replace(HOUSE, name="its garage")), (house, on_map(box(114, 54, 130, 64)))
    )
    cells, owner = object_cells(placed, grid)
    shared = np.intersect1d(cells[owner == 0], cells[owner == 1])
    assert shared.size == 3 * 3
    assert (np.diff(cells) >= 0).all()
    assert len(set(zip(cells.tolist(), owner.tolist(), strict=True))) == cells.size


@given(st.floats(20, 100), st.floats(20, 80), st.floats(1, 25), st.floats(1, 25), st.floats(0, 180))
@settings(max_examples=30)
def test_a_building_has_the_cells_that_it_touches(x, y, length, width, turn):
    grid = Grid(np.zeros((50, 60)), 0.0, 100.0, 2.0)
    house = translate(rotate(box(-length, -width, length, width), turn), x, y)
    cells, _ = object_cells(PlacedObjects((HOUSE,), (house,)), grid)
    centre_x, centre_y = grid.cell_centres(np.arange(grid.values.size))
    boxes = shapely.box(centre_x - 1, centre_y - 1, centre_x + 1, centre_y + 1)
    area = shapely.area(shapely.intersection(boxes, house))
    inside = np.zeros(area.size, bool)
    inside[cells] = True
    # Slivers of cells at the border may go either way.
    assert inside[area > 1e-4].all()
    assert not inside[area == 0.0].any()


def test_no_objects_have_no_cells(grid):
    cells, owner = object_cells(PlacedObjects((), ()), grid)
    assert cells.size == owner.size == 0
    assert cells.dtype == owner.dtype == np.int64


def test_what_lies_beyond_the_map_has_no_cells(grid):
    half = on_map(box(-10, 50, 10, 60))
    cells, _ = object_cells(PlacedObjects((HOUSE,), (half,)), grid)
    assert cells.size == 25


# --- what is refused --------------------------------------------------------------------------


def test_missing_and_unusable_numbers(layer, grid):
    path = layer(TWO_HOUSES, house=["A", "B"], chf=[1.0, None], men=[2.0, -3.0], share=[0.5, 1.5])

    def refused(*words, **fields):
        with one_line(InputError, *words):
            read_objects(path, grid, kind="building", name="h", name_field="house", fields=fields)

    words = ["objects.gpkg: chf", "feature 2 (B) has no value", "objects[h].value"]
    refused(*words, value="chf")
    refused("men: feature 2 (B): is out of range", "found -3", "0 or more", persons="men")
    refused("share: feature 2 (B)", "found 1.5", "at most 1", presence="share")
    refused("objects[h].value_field: attribute not found", "nearest: chf", value="chff")
    refused("house: feature 1 (A): is not a number", "'A'", value="house")
    refused("objects[h].speed_kmh: does not go with kind building", speed_kmh="chf")


def test_names_that_repeat(layer, grid):
    path = layer(TWO_HOUSES, house=["A", "A"])
    words = ["house: name is used twice", "'A' in features 1 and 2", "objects[h].name_field"]
    with one_line(InputError, *words):
        read_objects(path, grid, kind="building", name="h", name_field="house")
    road = read_objects(layer([BEND], "r.gpkg"), grid, kind="road", name="x")
    house = read_objects(layer([box(9, 9, 12, 12)], "h.gpkg"), grid, kind="building", name="x")
    with one_line(InputError, "c.toml: objects", "'x'"):
        joined_objects([road, house], Path("c.toml"))
    with one_line(InputError, "used twice"):
        joined_objects([road, road])
    assert len(joined_objects([road, replace(house, objects=(HOUSE,))])) == len(road) + 1


@pytest.mark.parametrize(
    ("kind", "shape", "found"),
    [
        ("building", BEND, "LineString"),
        ("road", box(20, 20, 32, 30), "Polygon"),
        ("people", BEND, "LineString"),
    ],
)
def test_the_wrong_kind_of_geometry(layer, grid, kind, shape, found):
    words = ["objects[o].file: feature 1 is of the wrong kind", f"found {found}"]
    with one_line(InputError, *words):
        read_objects(layer([shape]), grid, kind=kind, name="o")


def test_objects_outside_the_map(layer, grid, caplog):
    path = layer([box(20, 20, 32, 30), box(500, 20, 512, 30)], house=["A", "B"])
    with one_line(InputError, "objects[h].file: feature 2 (B) lies outside the DEM", "x 2700500"):
        read_objects(path, grid, kind="building", name="h", name_field="house")
    with caplog.at_level(logging.WARNING, "sassgis"):
        read_objects(layer([box(-5, 20, 15, 30)], "p.gpkg"), grid, kind="building", name="hut")
    assert "25.0 % of it lies outside the DEM" in caplog.text


def test_a_system_that_does_not_fit(layer, grid):
    path = layer([translate(box(20, 20, 32, 30), 200_000, 0)])
    local = "has a coordinate system, yet the DEM is in local coordinates"
    for own, words in ((grid, "lies outside the DEM"), (replace(grid, crs=""), local)):
        with one_line(InputError, words):
            read_objects(path, own, kind="building", name="h")


def test_traffic_that_is_half_stated_or_too_much(layer, grid):
    path = layer([BEND])

    def refused(*words, **defaults):
        with one_line(InputError, *words):
            read_objects(path, grid, kind="road", name="r", defaults=defaults)

    refused("objects[r].speed_kmh", "not all of its numbers", traffic_per_day=100.0)
    refused("objects[r].traffic_per_day", "nothing says how many", speed_kmh=50.0)
    refused("speed_kmh", "above 0", **{**TRAFFIC, "speed_kmh": 0.0})
    words = ["more vehicles than fit on the road", "2.5 m of vehicles on each metre"]
    refused(*words, **{**TRAFFIC, "traffic_per_day": 600_000.0})


def test_stretches_shorter_than_cells_allow(layer, grid):
    with one_line(InputError, "objects[r].segment_m", "found 5", "6 m or more (3 cells)"):
        read_objects(layer([BEND]), grid, kind="road", name="r", segment_m=5.0)


def test_what_deserves_a_look(layer, grid, caplog):
    with caplog.at_level(logging.WARNING, "sassgis"):
        read_objects(layer([box(350, 250, 360, 260)]), grid, kind="building", name="hut")
        jam = {**TRAFFIC, "traffic_per_day": 300_000.0}
        read_objects(layer([BEND], "r.gpkg"), grid, kind="road", name="r", defaults=jam)
    assert "hut lies on nodata; no block arrives there" in caplog.text
    assert "hut has neither value nor people nor traffic" in caplog.text
    assert "r: vehicles cover 125 % of the length" in caplog.text


# --- vulnerability ----------------------------------------------------------------------------

HEAD = "kind,intensity,vulnerability,lethality,source\n"
ROWS = "building,low,0.01,0,test\nbuilding,mean,0.1,0.01,test\nbuilding,high,0.5,0.2,test\n"


def read_table(tmp_path, text):
    path = tmp_path / "v.csv"
    path.write_text(text, encoding="utf-8")
    return read_vulnerability(path, CODES)


def test_a_table_of_vulnerability(tmp_path):
    read = read_table(tmp_path, HEAD + ROWS)
    assert read.kinds == ("building",)
    assert [r.vulnerability for r in read.of("building")] == [0.01, 0.1, 0.5]
    assert [r.lethality for r in read.of("building")] == [0.0, 0.01, 0.2]
    mixed = HEAD + "\n".join(reversed(ROWS.split()))
    assert read_table(tmp_path, mixed).of("building") == read.of("building")
    # From a spreadsheet with decimal commas.
    text = (HEAD + ROWS).replace(",", ";").replace("0.1", "0,1")
    assert read_table(tmp_path, text).of("building")[1].vulnerability == 0.1


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("building,high,0.5,0.2,test\n", "", ["kind building: row is missing", "a row for high"]),
        ("building,low,0.01", "building,low,1.01", ["row 2: is out of range", "vulnerability"]),
        ("0.1,0.01,test", "0.1,-0.01,test", ["row 3: is out of range", "lethality", "-0.01"]),
        ("building,high", "bulding,high", ["row 4: unknown kind", "nearest: building"]),
        ("building,high", "building,hihg", ["row 4: unknown intensity", "nearest: high"]),
        ("building,high", "building,mean", ["row is there twice", "building, mean"]),
        ("0.5,0.2,test", "0.5,0.2,", ["row 4: is empty", "source"]),
        ("0.5,0.2,test", "much,0.2,test", ["row 4: is not a number", "'much'"]),
        ("lethality,source", "lethality,scource", ["unknown or repeated column", "scource"]),
        ("building,low,0.01,0,", "road,low,0.01,0.1,", ["row 2", "kind road", "kind vehicle"]),
        ("building,low,0.01,0,", "people,low,0.01,0,", ["row 2", "no value in money"]),
        (ROWS, "", ["has no rows"]),
    ],
)
def test_tables_that_cannot_be_used(tmp_path, old, new, words):
    assert old in HEAD + ROWS
    with one_line(InputError, "v.csv", *words):
        read_table(tmp_path, (HEAD + ROWS).replace(old, new, 1))


def test_vulnerability_that_falls_is_told(tmp_path, caplog):
    with caplog.at_level(logging.WARNING, "sassgis"):
        read_table(tmp_path, (HEAD + ROWS).replace("high,0.5", "high,0.05"))
    assert "vulnerability of kind building falls from 0.1 at mean to 0.05 at high" in caplog.text


def test_kinds_that_objects_need():
    whole = vulnerability()
    whole.check_covers([HOUSE, ROAD])
    part = Vulnerability(CODES, tuple(r for r in whole.rows if r.kind == "building"), "v.csv")
    part.check_covers([HOUSE])
    with one_line(InputError, "v.csv: kind", "expected road as well"):
        part.check_covers([HOUSE, ROAD])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"kind": "bridge"}, ["kind: unknown choice", "'bridge'"]),
        ({"value": float("nan")}, ["value: cannot be used"]),
        ({"persons": float("inf")}, ["persons: cannot be used"]),
        ({"value_per_m": 5.0}, ["value_per_m: does not go with a building"]),
        ({"traffic": ROAD.traffic}, ["traffic_per_day: does not go with a building"]),
    ],
)
def test_objects_that_cannot_be(change, words):
    with one_line(InputError, *words):
        replace(HOUSE, **change)
