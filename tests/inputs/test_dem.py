from __future__ import annotations

import logging
import math

import numpy as np
import pytest
from affine import Affine
from helpers.input_files import LV95, NORTH, WEST
from helpers.one_line import one_line
from pyproj import CRS

from sassgis.errors import InputError
from sassgis.inputs.dem import read_dem
from sassgis.settings.crs import crs_name, same_crs

HEIGHTS = 1000.0 + np.arange(20, dtype=float).reshape(4, 5)


def plane(x, y):
    return 1000.0 + 0.3 * (x - WEST) - 0.5 * (y - NORTH)


def test_geotiff_is_read_as_it_is_and_nodata_is_nan(make_dem):
    values = HEIGHTS.copy()
    values[0, 0], values[3, 4] = -9999.0, np.nan
    # Cells that differ from squares by rounding only are squares.
    place = Affine(10.0, 0.0, WEST, 0.0, -10.0 - 1e-6, NORTH)
    grid = read_dem(make_dem(values, nodata=-9999.0, transform=place))
    values[0, 0] = np.nan
    np.testing.assert_array_equal(grid.values, values)
    assert (grid.west, grid.north, grid.cell_size) == (WEST, NORTH, pytest.approx(10.0))
    assert CRS.from_wkt(grid.crs).to_epsg() == 2056 and grid.vertical_datum == ""
    assert grid.values.dtype == np.float64 and grid.values.flags.c_contiguous


@pytest.mark.parametrize(
    "corner",
    [
        f"xllcorner {WEST}\nyllcorner {NORTH - 15}",
        f"xllcenter {WEST + 2.5}\nyllcenter {NORTH - 12.5}",
    ],
    ids=["corner", "centre"],
)
def test_esri_ascii_without_prj(tmp_path, corner):
    path = tmp_path / "dem.asc"
    path.write_text(
        f"ncols 3\nnrows 3\n{corner}\ncellsize 5\nNODATA_value -9999\n"
        "901 902 903\n904 905 -9999\n907 908 909.5\n"
    )
    grid = read_dem(path, crs=LV95, vertical_datum="LN02")
    assert (grid.west, grid.north, grid.cell_size) == (WEST, NORTH, 5.0)
    np.testing.assert_array_equal(
        grid.values, [[901, 902, 903], [904, 905, np.nan], [907, 908, 909.5]]
    )
    assert CRS.from_wkt(grid.crs).to_epsg() == 2056
    assert grid.vertical_datum == "LN02"


def test_rows_that_run_north_and_columns_that_run_west_are_turned(make_dem):
    reference = read_dem(make_dem(HEIGHTS))
    south_up = make_dem(
        HEIGHTS[::-1], "up.tif", transform=Affine(10.0, 0.0, WEST, 0.0, 10.0, NORTH - 40.0)
    )
    west_up = make_dem(
        HEIGHTS[::-1, ::-1],
        "west.tif",
        transform=Affine(-10.0, 0.0, WEST + 50.0, 0.0, 10.0, NORTH - 40.0),
    )
    for path in (south_up, west_up):
        grid = read_dem(path)
        np.testing.assert_array_equal(grid.values, reference.values)
        assert grid.bounds == reference.bounds


def _plane_raster(transform: Affine, shape: tuple[int, int]) -> np.ndarray:
    rows, cols = np.mgrid[: shape[0], : shape[1]]
    a, b, c, d, e, f = transform[:6]
    col, row = cols + 0.5, rows + 0.5
    return plane(a * col + b * row + c, d * col + e * row + f)


def _assert_plane(grid, share):
    """Inner cells hold the plane exactly, as bilinear resampling must."""
    n_rows, n_cols = grid.shape
    x, y = grid.cell_centres(np.arange(n_rows * n_cols))
    off = np.abs(grid.values.ravel() - plane(x, y))
    known = np.isfinite(off)
    assert known.mean() > share
    # At the rim fewer than four neighbours are there: off by half a cell at most.
    assert np.nanmax(off) < 0.8 * grid.cell_size
    assert np.mean(off[known] < 1e-6) > 0.8


@pytest.mark.parametrize("angle", [0.0, 20.0, -35.0, 90.0])
def test_cells_that_are_not_square_with_north_up_are_resampled(make_dem, caplog, angle):
    cos, sin = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    tall = 10.0 if angle else 5.0
    transform = Affine(10.0 * cos, 10.0 * sin, WEST, 10.0 * sin, -tall * cos, NORTH)
    with caplog.at_level(logging.INFO, "sassgis"):
        grid = read_dem(make_dem(_plane_raster(transform, (40, 30)), transform=transform))
    assert grid.cell_size == pytest.approx(tall)
    width = 300.0 * cos + 400.0 * abs(sin)
    assert grid.shape[1] == math.ceil(width / tall - 1e-6)
    _assert_plane(grid, 0.3 if angle else 0.99)
    assert ("rotated" if angle else "not square") in caplog.text
    assert f"{grid.cell_size:g} m with north up" in caplog.text


@pytest.mark.parametrize(
    ("unit", "metres"), [("", 1.0), ("metre", 1.0), ("ft", 0.3048), ("US survey foot", 12 / 39.37)]
)
def test_scale_offset_and_unit_of_the_band_are_applied(make_dem, unit, metres):
    stored = np.arange(12).reshape(3, 4)
    grid = read_dem(make_dem(stored, dtype="int16", scale=0.5, offset=700.0, unit=unit))
    np.testing.assert_allclose(grid.values, (700.0 + 0.5 * stored) * metres, rtol=1e-12)


def test_height_system_and_its_unit_come_from_a_compound_system(make_dem, caplog):
    grid = read_dem(make_dem(HEIGHTS, crs="EPSG:2056+5728"), vertical_datum="RHN95")
    assert grid.vertical_datum == "LN02 height" and "RHN95" in caplog.text
    assert CRS.from_wkt(grid.crs).to_epsg() == 2056
    configured = read_dem(make_dem(HEIGHTS, crs=None), crs="EPSG:2056+5728")
    assert configured.vertical_datum == "LN02 height"
    feet = Affine(10.0, 0.0, 500_000.0, 0.0, -10.0, 4_400_000.0)
    grid = read_dem(make_dem(HEIGHTS, "ft.tif", crs="EPSG:26911+6360", transform=feet))
    assert grid.vertical_datum == "NAVD88 height (ftUS)"
    np.testing.assert_allclose(grid.values, HEIGHTS * 1200.0 / 3937.0, rtol=1e-12)


def test_the_same_system_in_another_spelling_is_no_conflict(make_dem):
    esri = CRS.from_epsg(31287).to_wkt("WKT1_ESRI")
    assert same_crs(CRS.from_wkt(esri), CRS.from_epsg(31287))
    where = Affine(10.0, 0.0, 250_000.0, 0.0, -10.0, 350_000.0)
    read_dem(make_dem(HEIGHTS, crs=esri, transform=where), crs="EPSG:31287")


def test_local_coordinates_must_be_asked_for(make_dem):
    path = make_dem(HEIGHTS, crs=None, transform=Affine(0.5, 0.0, -8.0, 0.0, -0.5, 3.0))
    grid = read_dem(path, crs="local")
    assert grid.crs == ""
    assert grid.bounds == (-8.0, 1.0, -5.5, 3.0)
    assert crs_name(grid.crs) == "local coordinates"


def test_transparency_band_does_no_harm(make_dem):
    opaque = np.full((4, 5), 255.0)
    opaque[1, 1] = 0.0
    path = make_dem(
        np.stack([HEIGHTS, opaque]), dtype="float32", photometric="minisblack", alpha="yes"
    )
    grid = read_dem(path)
    assert np.isnan(grid.values[1, 1])
    assert np.isfinite(grid.values).sum() == 19


def _refused(path, *words, **options):
    with one_line(InputError, path.name, *words):
        read_dem(path, **options)


def test_files_that_are_damaged_or_no_raster(make_dem, tmp_path):
    path = make_dem(np.random.default_rng(1).uniform(500, 600, (200, 200)))
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    _refused(path, "read", "expected")
    path.write_text("x y z\n1 2 3\n")
    _refused(path, "cannot be read as a raster", "found", "expected GeoTIFF")


def place(cell: float, west: float, north: float) -> dict[str, Affine]:
    return {"transform": Affine(cell, 0.0, west, 0.0, -cell, north)}


INFINITE = np.where(np.isin(HEIGHTS, (1007.0, 1018.0)), np.inf, HEIGHTS)
#: Heights, how they are written, how they are read, and words of the message.
WRONG = {
    "degrees": (HEIGHTS, {"crs": "EPSG:4326", **place(1e-4, 8.9, 46.4)}, {},
                ["terrain.crs", "in degrees", "WGS 84", "EPSG:32632"]),
    "metres tagged as degrees": (HEIGHTS, {"crs": "EPSG:4326"}, {},
                ["terrain.crs", "cannot be degrees", "2700000", "tagged with the wrong"]),
    "degrees tagged as metres": (HEIGHTS, place(1e-4, 8.9, 46.4), {},
                ["terrain.crs", "look like degrees", "LV95", "8.9", "EPSG:4326"]),
    "feet": (HEIGHTS, {"crs": "EPSG:2272"}, {},
             ["terrain.crs", "not in metres", "US survey foot", "rio warp"]),
    "no system": (HEIGHTS, {"crs": None}, {},
                  ["terrain.crs", "has no coordinate system", "EPSG:2056"]),
    "another system": (HEIGHTS, {}, {"crs": "EPSG:21781"},
                       ["terrain.crs", "LV95", "EPSG:21781", "differ"]),
    "local": (HEIGHTS, {}, {"crs": "local"}, ["terrain.crs", "LV95", "local", "differ"]),
    "no such system": (HEIGHTS, {"crs": None}, {"crs": "EPSG:lv95"},
                       ["terrain.crs", "'EPSG:lv95'", "such as EPSG:2056"]),
    "not true to scale": (HEIGHTS, {"crs": "EPSG:3857", **place(10.0, 990_000.0, 5_840_000.0)}, {},
                          ["terrain.crs", "scale 1.4", "EPSG:32632"]),
    "off the Earth": (HEIGHTS, {"crs": "EPSG:3035", **place(10.0, 4e9, 4e9)}, {},
                      ["terrain.crs", "do not belong", "4000000000"]),
    "narrow": (np.full((9, 2), 500.0), {}, {}, ["9 rows x 2 columns", "at least 3 x 3"]),
    "all nodata": (np.full((3, 4), -9999.0), {"nodata": -9999.0}, {},
                   ["band 1", "no height at all", "12 cells"]),
    "infinite": (INFINITE, {}, {},
                 ["band 1", "infinite", "2 cells", "row 2, column 3", "expected numbers"]),
    "bands": (np.stack([HEIGHTS, HEIGHTS]), {}, {},
              ["several bands", "2 bands", "one band", "rio stack"]),
    "no georeference": (HEIGHTS, {"transform": Affine.identity()}, {},
                        ["no georeference", "no corner", "world file"]),
    "unit": (HEIGHTS, {"unit": "fathom"}, {}, ["band 1", "'fathom'", "metres or feet"]),
    "complex numbers": (HEIGHTS, {"dtype": "complex64"}, {}, ["no real numbers", "complex64"]),
}  # fmt: skip


@pytest.mark.filterwarnings("ignore:The given matrix")
@pytest.mark.parametrize("case", WRONG)
def test_terrain_that_cannot_be_used(make_dem, case):
    heights, written, options, words = WRONG[case]
    _refused(make_dem(heights, **written), *words, **options)


def test_far_outside_the_area_of_use_is_a_warning(make_dem, caplog):
    where = Affine(10.0, 0.0, 500_000.0, 0.0, -10.0, 5_140_000.0)
    path = make_dem(HEIGHTS, crs="EPSG:32632", transform=where)
    read_dem(path)
    assert not caplog.records
    path = make_dem(HEIGHTS, "far.tif", transform=Affine(10.0, 0.0, 2.2e6, 0.0, -10.0, NORTH))
    read_dem(path)
    assert "outside the area of use" in caplog.text
    assert "far.tif" in caplog.text


@pytest.mark.parametrize("value", [-9999.0, 1e20, -501.0, 9001.0])
def test_undeclared_nodata(make_dem, value):
    values = HEIGHTS.copy()
    values[2, 1] = values[3, 0] = value
    words = ("band 1", "nodata that is not declared", "-500 to 9000 m", f"--nodata {value:g}")
    _refused(make_dem(values), *words, f"2 cells, the first {value:g} at row 3, column 2")


def test_heights_in_centimetres_are_no_nodata(make_dem):
    found = f"{HEIGHTS.size} cells, the first {100.0 * HEIGHTS[0, 0]:g} at row 1, column 1"
    _refused(make_dem(100.0 * HEIGHTS), "in another unit than metres", found, "-a_scale 0.01")


def test_images_and_maps_of_classes_draw_a_warning(make_dem, caplog):
    grey = np.random.default_rng(1).integers(0, 256, (12, 12))
    read_dem(make_dem(grey, dtype="uint8"))
    assert "hillshade" in caplog.text
    caplog.clear()
    zones = np.repeat([0, 1, 3, 4], 30).reshape(12, 10)
    read_dem(make_dem(zones, dtype="uint8"))
    assert "4 different numbers from 0 to 4: a map of classes" in caplog.text
    assert "hillshade" not in caplog.text
    caplog.clear()
    read_dem(make_dem(zones + 0.5))
    read_dem(make_dem(np.full((3, 3), 400.0)))
    assert not caplog.text


def test_a_wrong_system_can_be_overridden(make_dem):
    path = make_dem(HEIGHTS, crs="EPSG:4326")
    _refused(path, "terrain.crs", "cannot be degrees", "terrain.override_crs")
    grid = read_dem(path, "EPSG:2056", override_crs=True)
    assert crs_name(grid.crs).endswith("(EPSG:2056)")
    assert read_dem(path, "local", override_crs=True).crs == ""


def test_zeros_amid_mountains_draw_a_warning(make_dem, caplog):
    values = HEIGHTS - 1000.0  # from 0 to 19 m: by the sea
    read_dem(make_dem(values))
    assert not caplog.records
    values = HEIGHTS.copy()
    values[1, 1:3] = 0.0
    read_dem(make_dem(values))
    assert "2 cells hold exactly 0 while all others lie above 1000 m" in caplog.text
