from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from affine import Affine
from helpers.input_files import NORTH, ONE_BLOCK, WEST, at
from helpers.one_line import one_line
from helpers.sections import section_of
from hypothesis import given
from hypothesis import strategies as st

from sassgis.errors import InputError
from sassgis.inputs.config import load_config
from sassgis.inputs.ground_map import built_in_table, ground_raster, read_ground_table
from sassgis.settings.ground import GroundClass
from sassgis.settings.settings import GroundSettings

HEADER = (
    "name,eta_max,dp_min,dp_max,mu_f,mu_0,k,d_star_m,restitution,restitution_speed_mps,"
    "rolling_threshold,source,trust\n"
)
GOOD = "scree,0.5,0.1,0.4,0.8,0.5,0.2,0.4,0.3,9.144,0.2,measured 2020,fitted\n"


def settings(path=None, **keys):
    table = {**({} if path is None else {"file": path}), **keys}
    return section_of(GroundSettings, table, Path("config.toml"))


def test_rock_and_debris_hold_what_table_1_gives():
    table, paper = built_in_table(), built_in_table("1986")
    assert set(paper.names) == set(table.names) and settings().default in table.names
    rock, debris = (table.classes[table.index(name)] for name in ("rock", "debris"))
    assert (rock.dp_min, rock.dp_max) == (0.0, 0.3)
    assert (debris.dp_min, debris.dp_max) == (0.2, 0.6)
    shares = [paper.classes[paper.index(name)].eta_max for name in ("rock", "debris")]
    assert shares == [0.70, 0.55]


def test_every_class_says_where_its_values_are_from():
    for c in built_in_table().classes:
        # The law of the contact of the default readings is not of the paper.
        assert c.trust != "paper"
        if c.name in ("rock", "debris"):
            assert 0.6 <= c.mu_f <= 1.0
            assert 0.37 <= c.mu_0 <= 0.67
            assert 0.17 <= c.k <= 0.26
            assert "Table 1" in c.source
            assert "our choice within the ranges" in c.source
        else:
            assert c.source.startswith(("Unverified", "Calibrated: "))


def test_harder_ground_rebounds_more():
    table = {c.name: c for c in built_in_table().classes}
    order = ["soft_meadow", "debris", "rock", "asphalt"]
    # At 5 m/s, where blocks meet the ground after a fall of a metre: e/(1 + (v_n/v)²).
    rebounds = [
        table[name].restitution / (1.0 + (5.0 / table[name].restitution_speed_mps) ** 2)
        for name in order
    ]
    assert rebounds == sorted(rebounds) and rebounds[0] < rebounds[-1]


def test_own_classes_are_added_or_replace(tmp_path):
    path = tmp_path / "own.csv"
    path.write_text(HEADER.removesuffix(",source,trust\n") + "\nscree,.5,0,0,.8,.5,.2,.4,0,9,.1\n"
                    "rock,0.8,0,0.2,0.7,0.4,0.2,0,0,9,0.1\n")  # fmt: skip
    table = read_ground_table(path)
    assert table.names == (*built_in_table().names, "scree")
    # A source may be left out: the values are an estimate then.
    assert table.classes[-1] == GroundClass(
        "scree", eta_max=0.5, dp_min=0.0, dp_max=0.0, mu_f=0.8, mu_0=0.5, k=0.2, d_star_m=0.4,
        restitution=0.0, restitution_speed_mps=9.0, rolling_threshold=0.1,
        source="own table own.csv", trust="estimate", mu_v=0.0,
    )  # fmt: skip
    assert table.classes[table.index("rock")].eta_max == 0.8
    assert table.classes[table.index("debris")] == built_in_table().classes[1]


def test_toml_and_spreadsheet_tables_say_the_same(tmp_path):
    toml, sheet = tmp_path / "own.toml", tmp_path / "own.csv"
    toml.write_text(
        '[[classes]]\nname = "scree"\neta_max = 0.5\ndp_min = 0.1\ndp_max = 0.4\nmu_f = 0.8\n'
        "mu_0 = 0.5\nk = 0.2\nd_star_m = 0.4\nrestitution = 0.3\n"
        "restitution_speed_mps = 9.144\nrolling_threshold = 0.2\n"
        'source = "measured 2020"\ntrust = "fitted"\n'
    )
    sheet.write_bytes(
        b"\xef\xbb\xbf"
        + HEADER.replace(",", ";").encode()
        # A spreadsheet with decimal commas.
        + b"scree;0,5;0,1;0,4;0,8;0,5;0,2;0,4;0,3;9,144;0,2;measured 2020;fitted\r\n"
        + b";;;;;;;;;;;;\r\n"
    )
    assert read_ground_table(toml) == read_ground_table(sheet)


@given(values=st.tuples(*[st.floats(0.0, 1.0)] * 11))
def test_numbers_come_through_unchanged(values):
    import tempfile

    eta, a, b, *rest, speed, threshold, growth = values
    numbers = (eta, min(a, b), max(a, b), *rest, 0.1 + speed, threshold, growth)
    header = HEADER.replace("rolling_threshold,", "rolling_threshold,mu_v,")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "own.csv"
        path.write_text(header + "x," + ",".join(map(repr, numbers)) + ",s,paper\n")
        assert read_ground_table(path).rows()[-1].tolist() == tuple(numbers)


BAD_TABLES = [
    (HEADER.replace("mu_0,", "") + GOOD, ["row 1", "mu_0", "missing column"]),
    (HEADER.replace("mu_0", "mu0") + GOOD, ["row 1", "mu0", "unknown", "nearest: mu_0"]),
    (HEADER + GOOD.replace("0.3,9", "1.2,9"), ["row 2", "restitution", "1.2", "0 to 1"]),
    (HEADER + GOOD.replace("9.144", "0"), ["row 2", "restitution_speed_mps", "0.1 to 1e+06"]),
    (HEADER + GOOD.replace("0.8", "steep"), ["row 2", "mu_f", "'steep'", "finite number"]),
    (HEADER + GOOD + GOOD.replace("scree,0.5", "x,1.5"), ["row 3", "eta_max", "1.5", "0 to 1"]),
    (HEADER + GOOD.replace("0.1,0.4", "0.4,0.1"), ["row 2", "dp_min", "dp_max 0.1"]),
    (HEADER + GOOD.replace("scree", " "), ["row 2", "name", "expected text"]),
    (HEADER + GOOD.replace("fitted", "perhaps"), ["row 2", "trust", "perhaps", "paper, fitted"]),
    (HEADER + GOOD.replace("measured", "a, b"), ["row 2", "14 values", "expected 13"]),
    (HEADER + GOOD + GOOD, ["name", "twice", "'scree'"]),
    (HEADER, ["no ground class"]),
]


BAD_TOML = [
    ("[[classes]\n", ["not valid TOML"]),
    ("[rock]\neta_max = 1\n", ["keys rock", "[[classes]]"]),
    ('[[classes]]\nname = "a"\n', ["class number 1", "eta_max", "missing column"]),
]


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [*(("own.csv", *bad) for bad in BAD_TABLES), *(("own.toml", *bad) for bad in BAD_TOML)],
)
def test_tables_that_cannot_be_used(tmp_path, name, text, words):
    path = tmp_path / name
    path.write_text(text)
    with one_line(InputError, name, *words):
        read_ground_table(path)


TABLE = built_in_table()
ROCK, DEBRIS, TALUS = (TABLE.index(n) for n in ("rock", "debris", "talus"))


@pytest.mark.parametrize("file", ["ground.gpkg", "ground.geojson"])
def test_polygons_rule_the_cells_whose_centre_they_hold(make_layer, slope_grid, file):
    shapes = [at(0, 0, 104, 50), at(51, 20, 156, 80)]  # ends 1 m before and 1 m past a centre
    to = "EPSG:4326" if file.endswith("geojson") else None
    path = make_layer(shapes, file, to=to, kind=["rock", "talus"])
    classes = ground_raster(settings(path, class_field="kind"), slope_grid, TABLE)
    expected = np.full(slope_grid.shape, DEBRIS)
    expected[:5, :10] = ROCK
    expected[2:8, 5:16] = TALUS  # the later feature lies on top
    np.testing.assert_array_equal(classes, expected)


def test_polygons_that_do_not_count_are_named(make_layer, slope_grid, caplog):
    """Cells are 10 m wide, with centres at 5, 15, ... m."""
    road, wall = at(0, 51, 300, 54), at(101, 0, 104, 200)  # between the centres
    shapes = [at(20, 20, 60, 40), road, at(12, 12, 18, 18), wall, at(10, 10, 70, 50)]
    kinds = ["talus", "asphalt", "rock", "asphalt", "rock"]
    path = make_layer(shapes, "ground.gpkg", kind=kinds)
    classes = ground_raster(settings(path, class_field="kind"), slope_grid, TABLE)
    assert set(np.unique(classes)) == {ROCK, DEBRIS}
    narrow, hidden = caplog.messages
    assert "feature 2 (asphalt), feature 4 (asphalt): narrower than the cells of 10 m" in narrow
    # The small one holds one centre, and lies below the last one as the first does.
    assert "feature 1 (talus), feature 3 (rock): counts nowhere, as later" in hidden
    # A part of the terrain that cuts a polygon off says nothing of it.
    caplog.clear()
    part = slope_grid.part(slice(0, 3), slice(0, 3))
    path = make_layer([at(29, 0, 60, 60)], kind=["rock"])
    ground_raster(settings(path, class_field="kind"), part, TABLE, slope_grid)
    assert not caplog.messages


CODES = {"1": "rock", "2": "talus"}


@pytest.fixture
def code_raster(make_dem):
    def write(codes, **options):
        return make_dem(codes, "codes.tif", **{"dtype": "uint8", "nodata": 0, **options})

    return write


def test_raster_of_codes_is_aligned_by_the_nearest_cell(code_raster, slope_grid):
    codes = np.zeros((40, 30), int) + 1
    codes[10:20] = 2
    where = Affine(5.0, 0.0, WEST, 0.0, 5.0, NORTH - 200.0)
    path = code_raster(codes[::-1], transform=where, crs=None, nodata=None)
    classes = ground_raster(settings(path, raster_classes=CODES), slope_grid, TABLE)
    expected = np.full(slope_grid.shape, DEBRIS)
    expected[:, :15] = ROCK
    expected[5:10, :15] = TALUS
    assert classes.dtype == np.int32
    np.testing.assert_array_equal(classes, expected)


def test_raster_of_codes_in_another_system(code_raster, slope_grid):
    codes = np.full((40, 60), 1)
    codes[:, 30:] = 2
    where = Affine(10.0, 0.0, WEST - 2e6 - 150.0, 0.0, -10.0, NORTH - 1e6 + 100.0)
    path = code_raster(codes, transform=where, crs="EPSG:21781")
    classes = ground_raster(settings(path, raster_classes=CODES), slope_grid, TABLE)
    assert (classes[:, :14] == ROCK).all()
    assert (classes[:, 16:] == TALUS).all()


@pytest.fixture
def refused(slope_grid):
    def check(path, *words, grid=None, **keys):
        with one_line(InputError, *words):
            ground_raster(settings(path, **keys), grid or slope_grid, TABLE)

    return check


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("Talus", ["feature 2", "'Talus'", "nearest: talus"]),
        (None, ["feature 2 has no ground class"]),
    ],
)
def test_polygons_that_cannot_be_used(refused, make_layer, kind, words):
    path = make_layer([at(0, 0, 50, 50), at(50, 0, 90, 50)], kind=["rock", kind])
    refused(path, "release.gpkg", "kind", *words, class_field="kind")


def test_unknown_default_names_the_configuration(tmp_path, slope_grid):
    path = tmp_path / "run.toml"
    path.write_text(f'[ground]\ndefault = "rok"\n[profile]\n{ONE_BLOCK}')
    with one_line(InputError, "run.toml", "ground.default", "'rok'"):
        ground_raster(load_config(path).ground, slope_grid, TABLE)


@pytest.mark.parametrize(
    ("codes", "options", "words"),
    [
        (np.full((20, 30), 7), {}, ["ground.raster_classes", "code 7 in 600 cells", "1, 2"]),
        (np.full((20, 30), 1.5), {"dtype": "float32"}, ["whole number", "1.5 at row 1, column 1"]),
        (np.ones((2, 20, 30)), {}, ["several bands", "2 bands", "one band of codes"]),
        (np.ones((20, 30)), {"transform": Affine.identity()}, ["no georeference"]),
        (
            np.ones((20, 30)), {"transform": Affine(10.0, 0.0, WEST + 9e3, 0.0, -10.0, NORTH)},
            ["no ground class on the DEM", "overlaps"],
        ),
    ],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore:The given matrix")
def test_rasters_that_cannot_be_used(refused, code_raster, codes, options, words):
    path = code_raster(codes, **options)
    refused(path, "codes.tif", *words, raster_classes=CODES)


def test_rasters_with_keys_or_a_terrain_that_do_not_fit(refused, code_raster, slope_grid, tmp_path):
    path = code_raster(np.ones((20, 30)))
    refused(path, "codes.tif", "ground.file", "is a raster", "ground.raster_classes")
    words = ["ground.raster_classes", "class of code 1", "'stone'", "one of rock"]
    refused(path, *words, raster_classes={"1": "stone"})
    grid = replace(slope_grid, crs="")
    refused(path, "codes.tif", "local coordinates", "LV95", grid=grid, raster_classes={"1": "rock"})
    none = tmp_path / "none.tif"
    refused(none, "none.tif", "ground.file", "file not found", raster_classes={"1": "rock"})
