"""Bad input: one clear line that names file and field, no traceback, nothing half written."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path

import geopandas as gpd
import numpy as np
import pytest
import shapely
from helpers.small_slope import CELL, COLS, NORTH, ROWS, WEST, Slope, heights, release_box
from rasterio.transform import from_origin

from sassgis.model.errors import InputError

OWN = "own,{},0.1,0.2,0.5,0.4,1,0.1,0,9,0.1,me,estimate"
CLASSES = (
    "name,eta_max,dp_min,dp_max,mu_f,mu_0,k,d_star_m,restitution,restitution_speed_mps,"
    "rolling_threshold,source,trust\n"
)


def holes(value: float, inside: bool) -> Callable[[Slope], None]:
    def spoil(slope: Slope) -> None:
        values = heights()
        if inside:
            values[10:25, :12] = value
        else:
            values[:] = value
        slope.write_dem(values)

    return spoil


def config(**changes: str) -> Callable[[Slope], None]:
    return lambda slope: slope.write_config(**changes)


def dem(values: np.ndarray | None = None, **options: object) -> Callable[[Slope], None]:
    return lambda slope: slope.write_dem(heights() if values is None else values, **options)


def release(*shapes: object) -> Callable[[Slope], None]:
    return lambda slope: slope.write_release(*shapes)


def classes(row: str) -> Callable[[Slope], None]:
    def spoil(slope: Slope) -> None:
        (slope.folder / "classes.csv").write_text(CLASSES + row + "\n")
        slope.write_config(ground__classes='"classes.csv"', ground__default='"own"')

    return spoil


def removed(name: str) -> Callable[[Slope], None]:
    return lambda slope: (slope.folder / name).unlink()


def written(text: str | bytes, name: str = "config.toml", key: str = "") -> Callable[[Slope], None]:
    """A file of that content; a text for the configuration stands below what is there."""

    def spoil(slope: Slope) -> None:
        if key:
            slope.write_config(**{key: f'"{name}"'})
        file = slope.folder / name
        before = slope.config.read_bytes() if file == slope.config else b""
        file.write_bytes(before + (text.encode() if isinstance(text, str) else text))

    return spoil


def areas(name: str) -> Callable[[Slope], None]:
    def spoil(slope: Slope) -> None:
        frame = gpd.read_file(slope.folder / "release.gpkg")
        frame["name"] = name
        frame.to_file(slope.folder / "release.gpkg", driver="GPKG")

    return spoil


def pipe(name: str) -> Callable[[Slope], None]:
    def spoil(slope: Slope) -> None:
        (slope.folder / name).unlink()
        os.mkfifo(slope.folder / name)

    return spoil


def folder(slope: Slope) -> None:
    slope.config.unlink()
    slope.config.mkdir()


def no_features(slope: Slope) -> None:
    frame = gpd.read_file(slope.folder / "release.gpkg").iloc[:0]
    (slope.folder / "release.gpkg").unlink()
    frame.to_file(slope.folder / "release.gpkg", driver="GPKG", geometry_type="Polygon")


def unknown_key(slope: Slope) -> None:
    slope.config.write_text(slope.config.read_text() + "\n[zones]\nmin_aera_m2 = 3\n")


#: A station in each of so many sections.
STATIONS = "".join(f'[[stations]]\nname = "{i % 20_000}"\nchainage_m = 1\n' for i in range(20_001))
#: Bytes of a file elsewhere as heights.
RAW = (
    '<VRTDataset rasterXSize="9" rasterYSize="9"><GeoTransform>0,1,0,9,0,-1</GeoTransform>'
    '<VRTRasterBand dataType="Byte" band="1" subClass="VRTRawRasterBand"><SourceFilename>'
    "/etc/services</SourceFilename></VRTRasterBand></VRTDataset>"
)
BOW = shapely.Polygon(
    [
        (WEST + 10, NORTH - 50),
        (WEST + 20, NORTH - 60),
        (WEST + 20, NORTH - 50),
        (WEST + 10, NORTH - 60),
    ]
)
DEGREES = from_origin(8.7, 46.5, 2e-5, 2e-5)
FEET = 'PROJCS["f",GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]],PROJECTION["Transverse_Mercator"],PARAMETER["latitude_of_origin",0],PARAMETER["central_meridian",9],PARAMETER["scale_factor",0.9996],PARAMETER["false_easting",1640416.6667],PARAMETER["false_northing",0],UNIT["US survey foot",0.304800609601219]]'  # noqa: E501

#: Name: what spoils the slope, the file (or key) that the line must name, words that it must hold.
BAD = {
    "geographic CRS": (dem(crs="EPSG:4326", transform=DEGREES), "dem.tif", ["degrees"]),
    "metres tagged as degrees": (dem(crs="EPSG:4326"), "dem.tif", ["degrees", "wrong"]),
    "CRS in feet": (dem(crs=FEET), "dem.tif", ["foot|feet", "met"]),
    "no CRS": (dem(crs=None), "dem.tif", ["terrain.crs", "coordinate system"]),
    "unknown height unit": (dem(unit="furlong"), "dem.tif", ["furlong"]),
    "nodata under the release": (holes(np.nan, True), "release.gpkg", ["area a", "nodata"]),
    "nothing but NaN": (holes(np.nan, False), "dem.tif", ["no height|nodata|no known"]),
    "infinite cells": (holes(np.inf, True), "dem.tif", ["inf"]),
    "1 x 1 DEM": (dem(np.array([[1500.0]])), "dem.tif", ["1 rows x 1 columns", "3 x 3"]),
    "release outside": (
        release(release_box(col=500.0)), "release.gpkg", ["area a", "outside the DEM", "2700000"]
    ),
    "release empty": (no_features, "release.gpkg", ["empty"]),
    "release crosses itself": (release(BOW), "release.gpkg", ["area a", "Self-intersection"]),
    "unknown ground": (
        config(ground__default='"debri"'), "config.toml", ["ground.default", "debri"]
    ),
    "eta above 1": (classes(OWN.format(1.2)), "classes.csv", ["eta_max", "1.2"]),
    "eta negative": (classes(OWN.format(-0.1)), "classes.csv", ["eta_max", "-0.1"]),
    "class without a column": (classes("own,0.5"), "classes.csv", ["own|row|line"]),
    "axes reversed": (config(blocks__axis_1_m="[0.9, 0.5]"), "config.toml", ["axis_1_m", "0.9"]),
    "axes zero": (config(blocks__axis_2_m="0.0"), "config.toml", ["axis_2_m", "above 0"]),
    "no number": (
        config(release__spacing_m='"five"'), "config.toml", ["release.spacing_m", "five"]
    ),
    "NaN as a setting": (config(terrain__smoothing_m="nan"), "config.toml", ["smoothing_m"]),
    "unknown key": (unknown_key, "config.toml", ["min_aera_m2", "min_area_m2"]),
    "broken TOML": (
        lambda s: s.config.write_text("[terrain\n"), "config.toml", ["TOML", "line 1"]
    ),
    "no configuration": (removed("config.toml"), "config.toml", ["not found"]),
    "no DEM": (removed("dem.tif"), "dem.tif", ["terrain.dem", "not found"]),
    "no release": (removed("release.gpkg"), "release.gpkg", ["release.file", "not found"]),
    "DEM is text": (
        lambda s: (s.folder / "dem.tif").write_text("heights"), "dem.tif", ["raster"]
    ),
    "DEM is made of another file": (written(RAW, "dem.tif"), "dem.tif", ["VRTRawRasterBand"]),
    "DEM is a pipe": (pipe("dem.tif"), "dem.tif", ["terrain.dem", "no file", "pipe"]),
    "release is a pipe": (pipe("release.gpkg"), "release.gpkg", ["release.file", "pipe"]),
    "configuration is a pipe": (pipe("config.toml"), "config.toml", ["no file", "pipe"]),
    "configuration is a folder": (folder, "config.toml", ["no file", "folder"]),
    "configuration without end": (
        written("#" * 3_000_000), "config.toml", ["too large", "3 MB", "2 MB"]
    ),
    "nested lists": (
        written("[project]\nname = " + "[" * 20_000 + "]" * 20_000), "config.toml", ["nested"]
    ),
    "nested tables": (
        written("[project]\nname = " + "{a = " * 9000 + "1" + "}" * 9000), "config.toml", ["nested"]
    ),
    "nested keys": (
        written("[project]\n" + "a." * 500_000 + "b = 1"), "config.toml", ["nested too deeply"]
    ),
    "lists of lists": (
        written("[project]\nname = " + "[" * 30 + "]" * 30), "config.toml", ["project.name", "deep"]
    ),
    "a number of many digits": (
        config(release__spacing_m="9" * 100_000), "config.toml", ["thousands of digits"]
    ),
    "a number of many bits": (
        config(release__spacing_m="0x" + "f" * 100_000),
        "config.toml", ["release.spacing_m", "400000 bits", "63 bits"],
    ),
    "a huge exponent": (config(release__spacing_m="1e999999"), "config.toml", ["spacing_m", "inf"]),
    "no such day": (config(project__date='"2026-02-30"'), "config.toml", ["project.date"]),
    "many stations": (written(STATIONS), "config.toml", ["used twice", "'0'"]),
    "a title of 5,000 characters": (
        config(project__name=f'"{"n" * 5000}"'),
        "config.toml", ["project.name", "5000 characters", "1000"],
    ),
    "a key of 5,000 characters": (
        written(f"[project]\n{'n' * 5000} = 1"), "config.toml", ["5000 characters"]
    ),
    "NUL in a title": (
        config(project__name='"a\\u0000b"'), "config.toml", ["project.name", r"\\x00"]
    ),
    "NUL in a path": (config(terrain__dem='"a\\u0000b"'), "config.toml", ["dem", r"\\x00"]),
    "a path of 300 characters": (
        config(release__file=f'"{"n" * 300}"'), "config.toml", ["release.file", "too long"]
    ),
    "a path of a home that is none": (config(terrain__dem='"~n0b0dy/x"'), "~n0b0dy", ["not found"]),
    "an area of 5,000 characters": (
        areas("n" * 5000),
        "release.gpkg", ["layer release, name", "feature 1", "5000 characters", "1000"],
    ),
    "a class of 5,000 characters": (
        classes(OWN.format(0.5).replace("own", "n" * 5000)),
        "classes.csv", ["name", "row 2", "5000 characters"],
    ),
    "a source of 200,000 characters": (
        classes(OWN.format(0.5).replace("me", "n" * 200_000)), "classes.csv", ["row 2", "131072"]
    ),
    "NUL in a class": (
        classes(OWN.format(0.5).replace("own", "a\0b")), "classes.csv", ["row 2", r"\\x00"]
    ),
    "classes nested": (
        written("classes = " + "[" * 20_000, "own.toml", "ground__classes"), "own.toml", ["nested"]
    ),
    "classes of 5,000 characters": (
        written(f'[[classes]]\nname = "{"n" * 5000}"', "own.toml", "ground__classes"),
        "own.toml", ["classes.name", "5000 characters"],
    ),
    "no name field": (config(release__name_field='"nam"'), "release.gpkg", ["nam", "name"]),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_one_line_and_no_result(slope: Slope, call, name: str) -> None:
    spoil, file, words = BAD[name]
    spoil(slope)
    out = slope.folder / "result"
    code, printed, err = call("run", slope.config, "-o", out)
    assert code == 2
    lines = [line for line in err.splitlines() if not line.endswith("...")]
    assert len(lines) == 1 and lines[0].startswith("Error: "), err
    assert file in lines[0]
    for word in words:
        assert re.search(word, lines[0], re.IGNORECASE), (word, lines[0])
    assert "Traceback" not in err and printed == ""
    assert not out.exists() and not list(slope.folder.glob("*.partial"))
    # The check beforehand says the same.
    code, _, checked = call("validate", slope.config)
    assert (code, checked.splitlines()[-1]) == (2, lines[0])


@pytest.mark.parametrize("name", ["no DEM", "axes reversed"])
def test_debug_shows_the_traceback(slope: Slope, call, name: str) -> None:
    BAD[name][0](slope)
    for arguments in (("--debug", "validate", slope.config), ("validate", slope.config, "--debug")):
        code, _, err = call(*arguments)
        assert code == 2 and "Traceback (most recent call last)" in err
        assert err.splitlines()[-1].startswith("Error: ")


def test_a_flat_release_area_draws_a_warning_and_gives_an_honest_result(slope: Slope, call) -> None:
    slope.write_release(release_box(col=60.0))
    code, out, _ = call("validate", slope.config)
    assert code == 0 and "WARNING" in out and "area a" in out and "0.0 degrees" in out
    code, _, err = call("run", slope.config, "-o", slope.folder / "result")
    assert code == 0
    assert "degrees" in err and ("never started" in err or "not simulated" in err)


def test_no_map_is_made_where_no_rock_can_be_followed(slope: Slope, call) -> None:
    slope.write_dem(np.full((ROWS, COLS), 500.0))
    slope.write_config(terrain__path='"fall_line"')
    code, _, err = call("run", slope.config, "-o", slope.folder / "result")
    assert code == 2
    line = err.splitlines()[-1]
    assert line.startswith("Error: ") and "release.gpkg" in line
    assert "no block could be simulated" in line and "lines that end where they begin" in line
    assert not list(slope.folder.glob("result*"))


def test_some_nodata_under_the_release_is_told(slope: Slope, call) -> None:
    values = heights()
    values[16:18, 3:6] = np.nan
    slope.write_dem(values)
    code, out, _ = call("validate", slope.config)
    assert code == 0 and "nodata" in out.split("WARNING")[1]


def test_a_result_that_is_there_is_not_replaced(slope: Slope, call) -> None:
    out = slope.folder / "mine"
    out.mkdir()
    (out / "letter.txt").write_text("dear")
    for more in ((), ("--overwrite",)):
        code, _, err = call("run", slope.config, "-o", out, *more)
        assert code == 3 and err.startswith("Error: ") and str(out) in err
    assert [p.name for p in out.iterdir()] == ["letter.txt"]


def test_init_does_not_replace_a_file(tmp_path: Path, call) -> None:
    file = tmp_path / "mine.toml"
    file.write_text("mine")
    code, _, err = call("init", file)
    assert code == 3 and err.startswith(f"Error: {file}: exists")
    assert file.read_text() == "mine"
    code, _, err = call("init", file / "folder.toml")
    assert code == 3 and err.startswith("Error: ") and err.count("\n") == 1


def test_usage_errors_are_one_line_too(slope: Slope, call) -> None:
    for arguments in (
        ("run", slope.config), ("rn",), ("run", slope.config, "-o", "x", "--jobs", "-1"),
        ("run", slope.config, "-o", "x", "--seed", "a"),
        ("run", slope.config, "-o", "x", "--jobs", "1", "--workers", "2"),
        ("zone", slope.config, "-o", "x", "--workers", "1", "--scheduler", "tcp://127.0.0.1:9"),
        ("profile", slope.config, "-o", "x", "--csv", "a", "--point", "1", "2"),
        ("profile", slope.config, "-o", "x", "--line", "a", "--point", "1", "2"),
        ("init", slope.folder / "new.toml", "--set", "release.spacing=5"),
    ):  # fmt: skip
        code, _, err = call(*arguments)
        assert code == 2 and err.startswith("Error: ") and err.count("\n") == 1
    code, _, err = call("run", slope.config, "-o", slope.folder / "x", "--area", "area b")
    assert code == 2 and "area b" in err and "area a" in err


@pytest.mark.parametrize("command", ["run", "zone", "demo", "new"])
@pytest.mark.parametrize("more", [(), ("--overwrite",)])
def test_the_root_of_the_disk_is_no_result(
    slope: Slope, call, command: str, more: tuple[str, ...]
) -> None:
    arguments = {"run": (slope.config, "-o"), "zone": (slope.config, "-o"), "demo": ("-o",)}
    code, _, err = call(command, *arguments.get(command, ()), "/", *more)
    assert code == 3 and err.startswith("Error: /: ") and err.count("\n") == 1


@pytest.mark.parametrize(
    ("option", "exit_code"), [("validate", 2), ("dem check", 2), ("batch", 2), ("init", 3)]
)
def test_a_path_that_no_system_takes(call, option: str, exit_code: int, tmp_path: Path) -> None:
    """A file that is read, or one that is written."""
    more = ["-o", "x"] if option == "batch" else []
    code, _, err = call(*option.split(), tmp_path / ("n" * 300), *more)
    assert code == exit_code and err.startswith("Error: ") and err.count("\n") == 1
    assert re.search("(name|path is) too long", err)


def test_a_message_is_short_and_steers_no_terminal() -> None:
    error = InputError("a\x1b[2J", file="f" * 9000, found="\u202e\n" + "b" * 9000, expected="c")
    assert (
        len(str(error)) < 1500 and str(error).isprintable() and str(error).endswith("expected c)")
    )


def test_cells_are_two_metres(slope: Slope, call) -> None:
    code, out, _ = call("validate", slope.config)
    assert code == 0
    assert f"{ROWS} rows x {COLS} columns of {CELL:g} m" in out
